"""One calibration in a process of its own: ``python -m handeye_fg.batching.one``.

The order comes as a line of JSON on stdin, the outcome goes to a file. Whatever happens here, such as a
segmentation fault in a library, happens to this process alone; and it ends when the one that started it
ends, since its stdin is then closed.
"""

import json
import os
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from handeye_fg.errors import HandEyeError
from handeye_fg.io.config import read_config
from handeye_fg.io.files import write_atomic

_ORPHANED = 143


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What to calibrate; all places are local paths.

    Attributes:
        poses, images, model, camera, masks, target: as in ``DataSet``.
        config: file of the options.
        output: folder for the results.
        outcome: file that says how it ended: ``status`` and ``message``.
    """

    poses: str
    images: str | None
    model: str | None
    camera: str | None
    masks: str | None
    target: str | None
    config: str
    output: str
    outcome: str


def main() -> None:
    """Read the order, calibrate, and say how it ended."""
    order = Order(**json.loads(sys.stdin.buffer.readline()))
    threading.Thread(target=_end_with, args=(sys.stdin.fileno(),), daemon=True).start()
    with suppress(OSError):  # where memory runs out, Linux ends this process before any other
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    try:
        status, message = _calibrated(order)
    except HandEyeError as error:
        status, message = "failed", " ".join(str(error).split())
    write_atomic(Path(order.outcome), json.dumps({"status": status, "message": message}))
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # all is written; to take the libraries down again costs time, and can fail


def _calibrated(order: Order) -> tuple[str, str]:
    from handeye_fg.from_model import refine  # noqa: PLC0415  # first the watch, then what takes seconds
    from handeye_fg.io.config import write_config  # noqa: PLC0415  # heavy
    from handeye_fg.pipeline import calibrate  # noqa: PLC0415  # heavy
    from handeye_fg.report import write_report  # noqa: PLC0415  # heavy

    options, output = read_config(Path(order.config)), Path(order.output)
    if order.model is not None:
        result = refine(order.model, order.poses, options)
    else:
        result = calibrate(
            order.images or "",
            order.poses,
            camera=order.camera,
            masks=order.masks,
            options=options,
            target=order.target,
            output=output,
        )
    result.save(output)
    write_report(result, output)
    write_config(options, output / "config.toml")
    return result.status, result.message


def _end_with(stream: int) -> None:
    """End this process when the stream, a file descriptor, does."""
    while os.read(stream, 1):
        pass
    os._exit(_ORPHANED)


if __name__ == "__main__":
    main()
