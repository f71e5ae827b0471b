"""A stand-in for the pipeline."""

import dataclasses
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from handeye_fg.io.results import Result
from handeye_fg.options import Options


@dataclasses.dataclass
class Calibration:
    """Answers at once, or raises, and keeps what it was asked."""

    answer: Result | BaseException
    asked: dict[str, Any] = dataclasses.field(default_factory=dict)
    verbose: list[bool] = dataclasses.field(default_factory=list)

    def calibrate(
        self,
        images: Path,
        poses: Path,
        camera: Path | None = None,
        masks: Path | None = None,
        options: Options | None = None,
        *,
        output: Path | None = None,
        target: Path | None = None,
        holdout: tuple[Path, Path] | None = None,
        progress: Callable[[str, int, int | None], None],
    ) -> Result:
        self.asked = {"images": images, "poses": poses, "camera": camera, "masks": masks}
        self.asked |= {"options": options, "output": output, "target": target, "holdout": holdout}
        for done in range(3):
            progress("images", done, 2)
        progress("iterations", 1, None)
        progress("iterations", 7, None)
        progress("registered", 2, 2)
        logging.getLogger("handeye_fg.sfm").info("a detail of the library")
        logging.getLogger("handeye_fg.sfm").warning("a warning of the library")
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer
