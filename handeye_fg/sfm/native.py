"""How COLMAP's long calls are run: cancellable, counted, quiet, their failures translated."""

import threading
from collections.abc import Callable
from typing import TypeVar

import pycolmap

from handeye_fg.errors import ReconstructionError
from handeye_fg.options import SfmOptions
from handeye_fg.types import CameraModel

T = TypeVar("T")

# glog's levels: 0 information, 3 fatal. COLMAP also logs failures that another attempt mends.
_QUIET, _VERBOSE = 3, 0
# How often counts are read and an interrupt is noticed.
_POLL_S = 0.1
# COLMAP's meaning of "all cores".
_ALL_CORES = -1


def native_threads(options: SfmOptions) -> int:
    """The number of threads as COLMAP wants it."""
    return options.threads or _ALL_CORES


def set_verbosity(verbose: bool) -> None:
    """Show COLMAP's own log on stderr, or silence it; silent unless this is called."""
    pycolmap.logging.minloglevel = _VERBOSE if verbose else _QUIET
    pycolmap.logging.alsologtostderr = verbose


set_verbosity(verbose=False)


def run_cancellable(
    call: Callable[[pycolmap.CancellationToken], T], what: str, poll: Callable[[], None]
) -> T:
    """Run a call of COLMAP in a thread of its own, so that Ctrl-C is heard.

    An exception in this thread, an interrupt above all, cancels the call and waits for its end: COLMAP
    stops after the image or the pair at hand.

    Args:
        call: takes the token that cancels it.
        what: the stage, for error messages.
        poll: called some times a second while the call runs, and once after its end.

    Returns:
        What the call returned.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    token = pycolmap.CancellationToken()
    results: list[T] = []
    failures: list[Exception] = []

    def work() -> None:
        try:
            results.append(call(token))
        except Exception as error:  # noqa: BLE001  raised again in the caller's thread
            failures.append(error)

    thread = threading.Thread(target=work, name=f"colmap {what}", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_POLL_S)
            poll()
        poll()
    except BaseException:
        token.cancel()
        thread.join()
        raise
    if failures:
        failure = failures[0]
        if isinstance(failure, RuntimeError | ValueError | IndexError | OSError):
            raise ReconstructionError(
                f"structure from motion failed during {what}: {failure}; check that all images can "
                "be opened, and the free disk space"
            ) from failure
        raise failure
    return results[0]


def native_camera(camera: CameraModel, camera_id: int) -> pycolmap.Camera:
    """A camera as COLMAP has it."""
    native = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=camera.params
    )
    native.camera_id = camera_id
    return native
