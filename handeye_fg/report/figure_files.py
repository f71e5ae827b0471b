"""The figures of the report as files; entry point ``write_figures``."""

from pathlib import Path

from handeye_fg.io.files import write_atomic
from handeye_fg.io.results import Result
from handeye_fg.report.figures import drawings


def write_figures(result: Result, folder: str | Path) -> tuple[Path, ...]:
    """Write each figure of the report as SVG and as PNG, on white.

    Args:
        result: what to draw.
        folder: where; made if missing.

    Returns:
        The files.

    Raises:
        InputDataError: the folder cannot be written.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     files = hf.write_figures(hf.solve(robot, camera), folder)
        >>> files[0].name
        'distance.svg'
    """
    return tuple(
        write_atomic(Path(folder) / f"{drawing.name}.{form}", drawing.content(form))
        for drawing in drawings(result)
        for form in ("svg", "png")
    )
