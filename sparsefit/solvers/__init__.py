"""Solvers of regression problems: sparsefit's own, and those of others behind one registry."""
