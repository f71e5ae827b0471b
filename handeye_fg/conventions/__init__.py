"""Whether robot poses are as they are said to be: unit, order, direction, handedness, rows.

``judge`` holds every reading of the poses against the camera's and gives a ``Verdict``; ``sentence`` and
``table`` say it in words; ``converted`` applies a named convention. Nothing is converted unasked.
"""

from handeye_fg.conventions.evidence import extent_of
from handeye_fg.conventions.files import file_readings
from handeye_fg.conventions.reading import Reading
from handeye_fg.conventions.readings import AS_GIVEN, converted, readings
from handeye_fg.conventions.verdict import Judged, Verdict, judge
from handeye_fg.conventions.whole_poses import UNITS
from handeye_fg.conventions.wording import remedy, sentence, table

__all__ = [
    "AS_GIVEN",
    "UNITS",
    "Judged",
    "Reading",
    "Verdict",
    "converted",
    "extent_of",
    "file_readings",
    "judge",
    "readings",
    "remedy",
    "sentence",
    "table",
]
