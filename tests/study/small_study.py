"""The small studies that several tests run, of problems and of flights of 50 samples."""

PROBLEMS = """
name = "p"
kind = "problems"
question = "Who?"
tolerances = [1e-4]
[path]
points = 4
lowest = 0.1
[clock]
limit = 5.0
repeats = 4
seconds = 0.5
"""
CORRELATED = '[[problems]]\ngenerator = "correlated"\nsamples = 60\ncolumns = 20\n'


def small_study(name: str, *, count: int, seed: int = 3, duration: float = 1.0) -> str:
    """A study file up to its library: what a test is about follows."""
    return f"""
name = "{name}"
question = "?"
seed = {seed}
[flights]
count = {count}
timescale = 0.5
length_scale = {{ uniform = [3.0, 6.0] }}
response_time = 0.5
thrust_acceleration = [5.0, 3.0]
duration = {duration}
sample_rate = 50.0
[library]
lower = 3.0
upper = 6.0
step = 1.0
"""
