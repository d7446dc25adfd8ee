"""The processes of a study of solvers: one for each family of contenders, one working at a time."""

from __future__ import annotations

from collections.abc import Sequence

from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.run.solver_worker import Answer, Ask, Hand, Lost, Worker
from sparsefit.study.spec.solver_study import SolverStudy


class Crew:
    """A process for each family of contenders; one works at a time, the others wait."""

    def __init__(self, study: SolverStudy, problems: Sequence[RegressionProblem]) -> None:
        self._study = study
        self.problems = problems
        self._workers: dict[str, Worker] = {}
        self._met: dict[str, set[int]] = {}
        self._holds: dict[str, int] = {}
        self.first_seconds: dict[int, float] = {}

    def ask(self, ask: Ask) -> Answer | Lost:
        """The answer; before it a first call, and the problem, where the process has not had them.

        The problem is built once, here, and handed over.
        """
        number = ask.case.contender
        name = self._study.contenders[number].family
        worker = self._workers.setdefault(name, Worker(self._study))
        if number not in self._met.setdefault(name, set()):
            answer = worker.ask(Ask("first", ask.case))
            if isinstance(answer, Lost):
                return self._forget(name, Lost(answer.status, f"its first call: {answer.reason}"))
            self._met[name].add(number)
            if answer.timing:
                self.first_seconds.setdefault(number, answer.timing.cpu)
        if self._holds.get(name) != ask.case.problem:
            handed = worker.ask(Hand(self.problems[ask.case.problem]))
            if isinstance(handed, Lost):
                return self._forget(name, handed)
            self._holds[name] = ask.case.problem
        answer = worker.ask(ask)
        return self._forget(name, answer) if isinstance(answer, Lost) else answer

    def _forget(self, name: str, lost: Lost) -> Lost:
        """The process is gone, and with it what it had met and held."""
        self._met[name].clear()
        self._holds.pop(name, None)
        return lost

    def close(self) -> None:
        """End every process."""
        for worker in self._workers.values():
            worker.close()
