"""The figures in the README are those of results/table2, to the digits that it prints."""

import re
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
QUANTITIES = ("U0", "L_w", "τ_w")
SIGNED, SIZES = ("errors", "mean signed % error"), ("errors-absolute", "mean |error|")
BACKENDS = {"least squares": "least-squares rcond=None", "group-LASSO": "group-lasso"}
READINGS = {
    "printed in the paper": (*SIGNED, "paper, Table 2"),
    "the paper's protocol": (*SIGNED, "paper: {}"),
    "better readouts": (*SIZES, "better readouts: {}"),
    "default estimator": (*SIZES, "default: {}"),
}


def rows():
    """Reading, back-end, three errors and flights with an estimate of each row of the table."""
    above = ""
    text = (ROOT / "README.md").read_text("utf-8").replace("*", "").replace("−", "-")
    for line in text.split("|---|---|", 1)[1].splitlines()[1:]:
        if not line.startswith("|"):
            return
        reading, *cells = [cell.strip() for cell in line.strip("|").split("|")]
        above = reading if reading != "〃" else above
        yield above, *cells


def agrees(printed, value):
    """Whether a printed percentage is the value, rounded to its digits, or the bound holds."""
    number = re.sub(r"[<%\s]", "", printed)
    if printed.startswith("<"):
        return 0.0 <= value < float(number)
    mantissa, _, power = number.partition("e")
    digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(float(number) - value) <= 0.5001 * digit


@pytest.mark.parametrize("row", list(rows()), ids=lambda row: f"{row[0][:20]} {row[1]}")
def test_a_row_of_the_readme_is_a_row_of_the_results(row):
    reading, backend, *errors, flights = row
    name, _, setting = backend.partition(", ")
    words = [BACKENDS.get(name, name.lower()), "=".join(setting.split())]
    words = " ".join(words).replace("alpha=", "alpha_fraction=").strip()
    file, measure, title = next(v for k, v in READINGS.items() if reading.startswith(k))
    table = pd.read_csv(ROOT / f"results/table2/{file}.csv").set_index("title")
    values = table.loc[title.format(words)]
    for quantity, printed in zip(QUANTITIES, errors, strict=True):
        column = next(c for c in table if c.startswith(f"{measure} {quantity}") and "%" in c)
        assert agrees(printed, values[column]), (quantity, printed, values[column])
    answered, _, all_flights = flights.partition(" / ")
    expected = values["n"] if pd.isna(values["failures"]) else values["n"] - values["failures"]
    assert (int(answered), int(all_flights)) == (expected, values["n"])


def test_a_rounded_figure_is_told_from_a_wrong_one():
    assert agrees("-18.80 %", -18.803)
    assert not agrees("-18.80 %", -18.81)
    assert agrees("5e-6 %", 4.93e-6)
    assert not agrees("5e-6 %", 6e-6)
    assert agrees("< 1e-6 %", 9e-7)
    assert not agrees("< 1e-6 %", 2e-6)
