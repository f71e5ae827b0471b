"""The commands of the program, each with its flags and a ``run`` that returns the exit code.

Heavy packages are imported where they are used, so that help is quick.
"""

from typing import Protocol

from handeye_fg.commands.batch import Batch
from handeye_fg.commands.calibrate import Calibrate
from handeye_fg.commands.check import Check
from handeye_fg.commands.compare import Compare
from handeye_fg.commands.export import Export
from handeye_fg.commands.plan import PlanPoses
from handeye_fg.commands.report import Report
from handeye_fg.commands.simulate import Simulate
from handeye_fg.commands.solve import Solve


class Command(Protocol):
    """What was asked for, with its flags."""

    def run(self) -> int:
        """Do it; the exit code."""
        ...


COMMANDS: dict[str, type[Command]] = {
    "calibrate": Calibrate,
    "solve": Solve,
    "check": Check,
    "report": Report,
    "export": Export,
    "compare": Compare,
    "plan": PlanPoses,
    "batch": Batch,
    "simulate": Simulate,
}
"""Each command under its name, in the order of the help text."""

__all__ = [
    "COMMANDS",
    "Calibrate",
    "Check",
    "Command",
    "Compare",
    "Export",
    "PlanPoses",
    "Report",
    "Solve",
]
