"""From an estimator to C99 for the processor on board, with its model in Python.

A `Plan` says what of an estimator fits, or why not; `package` makes the files; `answers` is the
same recurrence in Python, which a test of the C compares with.
"""

from sparsefit.export.layout import refuse_large as refuse_large
from sparsefit.export.model import Tuning as Tuning
from sparsefit.export.model_answer import Answer as Answer
from sparsefit.export.model_answer import answers as answers
from sparsefit.export.package import package as package
from sparsefit.export.plan import Plan as Plan
