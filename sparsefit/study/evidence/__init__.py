"""What the rows say: errors, intervals, comparisons, a selection."""
