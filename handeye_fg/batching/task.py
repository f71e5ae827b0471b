"""What a worker does with one data set; entry point ``run_data_set``.

A calibration that is done leaves ``batch.json`` beside its ``result.json``, written last: where it has the
digest of the same input and options, it is not done again.
"""

import fcntl
import hashlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from handeye_fg.batching import sources
from handeye_fg.batching.manifest import DataSet
from handeye_fg.batching.one import Order
from handeye_fg.batching.rows import Row, figures_of
from handeye_fg.comparison import Comparison, compare
from handeye_fg.errors import HandEyeError, InputDataError
from handeye_fg.io.config import options_digest, read_config, write_config
from handeye_fg.io.fields import reason
from handeye_fg.io.files import write_atomic
from handeye_fg.io.result_reader import load_result
from handeye_fg.io.results import FILE_NAME, Result
from handeye_fg.options import Options
from handeye_fg.report.page import REPORT_NAME

RECORD, LOG = "batch.json", "log.txt"
_LOCK = ".lock"
_STAGES = "stages"  # what an interrupted calibration goes on from, on the same machine
_POLL_S = 0.1
_INPUTS = ("images", "model", "poses", "camera", "masks", "target")


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One data set, and how it is to be calibrated.

    Attributes:
        data: the data set.
        output: path or URL of the batch's folder.
        sign: name of a file in a local output, by which a worker knows that it sees the same folder.
        options: where the data set has none of its own.
        threads: to use, where the options leave it open.
        timeout_s: after so many seconds it has failed.
        significance: as for ``compare``, where it has a reference.
    """

    data: DataSet
    output: str
    sign: str
    options: Options
    threads: int
    timeout_s: float
    significance: float


def run_data_set(job: Job, wanted: Callable[[], bool]) -> Row:
    """Calibrate a data set in a process of its own, unless that is done; raises nothing.

    Args:
        job: what to do.
        wanted: asked some times a second; once it says no, the calibration is ended.
    """
    since = time.perf_counter()
    row = Row(
        name=job.data.name,
        status="failed",
        message="",
        kept=False,
        seconds=0.0,
        worker=socket.gethostname(),
    )
    try:
        with TemporaryDirectory(prefix="handeye-fg-") as scratch:
            row = _done(job, row, Path(scratch), wanted)
    except HandEyeError as error:
        row = replace(row, message=" ".join(str(error).split()))
    except Exception as error:  # noqa: BLE001  another data set must not suffer from it
        row = replace(row, message=f"unexpected {type(error).__name__}: {reason(error)}")
    return row if row.kept else replace(row, seconds=time.perf_counter() - since)


def _done(job: Job, row: Row, scratch: Path, wanted: Callable[[], bool]) -> Row:
    """The row of a data set that is calibrated now, or was before."""
    data = job.data
    config = None if data.config is None else sources.fetched(data.config, scratch / "config")
    options = job.options if config is None else read_config(Path(config))
    digest = _digest(data, options)
    with _folder(job, scratch, wanted) as (folder, lock):
        record = _record(folder / RECORD)
        if record.get("digest") == digest and record.get("status") in ("ok", "partial"):
            row = replace(row, kept=True, seconds=float(record["seconds"]))  # type: ignore[arg-type]  # JSON
        else:
            since = time.perf_counter()
            for stale in (RECORD, FILE_NAME, REPORT_NAME, LOG):
                (folder / stale).unlink(missing_ok=True)
            if options.sfm.threads == 0:
                options = replace(options, sfm=replace(options.sfm, threads=job.threads))
            record = _calibrated(job, options, folder, scratch, lock, wanted)
            record |= {"digest": digest, "seconds": round(time.perf_counter() - since, 3)}
            write_atomic(folder / RECORD, json.dumps(record, indent=1) + "\n")
            if sources.is_url(job.output):
                sources.put(folder, f"{job.output}/{data.name}", RECORD, left_out=_STAGES)
        if record["status"] == "failed":
            return replace(row, message=str(record["message"]))
        result = load_result(folder)
    row = replace(row, status=result.status, message=result.message, figures=figures_of(result))
    if data.reference is None:
        return row
    try:
        return replace(row, drift=_drift(result, data.reference, job.significance, scratch))
    except InputDataError as error:
        return replace(row, drift_problem=" ".join(str(error).split()))


def _digest(data: DataSet, options: Options) -> str:
    """SHA-256 of all that the result depends on; the number of threads is not part of it."""
    places = {key: place for key in _INPUTS if (place := getattr(data, key)) is not None}
    content = {
        "version": metadata.version("handeye-fg"),
        "options": options_digest(replace(options, sfm=replace(options.sfm, threads=0))),
        **{key: sources.signature(place) for key, place in places.items()},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@contextmanager
def _folder(
    job: Job, scratch: Path, wanted: Callable[[], bool]
) -> Iterator[tuple[Path, IO[bytes] | None]]:
    """The data set's folder on this machine, and its lock; for a URL a copy of what is kept of it."""
    name = job.data.name
    if sources.is_url(job.output):
        folder = scratch / "output"
        folder.mkdir()
        kept = f"{job.output}/{name}"
        if sources.exists(f"{kept}/{RECORD}"):
            for file in (RECORD, FILE_NAME):
                if sources.exists(f"{kept}/{file}"):
                    sources.fetched(f"{kept}/{file}", folder)
        yield folder, None
        return
    output = Path(job.output)
    if not (output / job.sign).exists():
        raise InputDataError(
            f"worker {socket.gethostname()} does not see the output folder {output}; give a folder that "
            "all machines share, or a URL"
        )
    folder = output / name
    if not folder.resolve().is_relative_to(output.resolve()):
        raise InputDataError(f"{folder} leads out of the output folder; remove the link")
    folder.mkdir(exist_ok=True)
    with (folder / _LOCK).open("wb") as lock:
        _wait_for(lock, folder, job.timeout_s, wanted)
        yield folder, lock


def _wait_for(lock: IO[bytes], folder: Path, timeout_s: float, wanted: Callable[[], bool]) -> None:
    """Take the lock; its holder may be a process that a batch has left behind and that is about to end."""
    until = time.monotonic() + timeout_s
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if time.monotonic() > until or not wanted():
                raise InputDataError(
                    f"{folder}: another batch is writing there; wait for its end"
                ) from error
            time.sleep(_POLL_S)
        else:
            return


def _record(path: Path) -> dict[str, object]:
    """What an earlier run has noted; empty if there is nothing that can be read."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    complete = isinstance(record, dict) and isinstance(record.get("seconds"), float)
    return record if complete and (path.parent / FILE_NAME).is_file() else {}


def _calibrated(
    job: Job,
    options: Options,
    folder: Path,
    scratch: Path,
    lock: IO[bytes] | None,
    wanted: Callable[[], bool],
) -> dict[str, object]:
    """``status`` and ``message`` of a calibration in a process of its own."""
    data = job.data
    local = {
        key: None
        if (place := getattr(data, key)) is None
        else sources.fetched(place, scratch / key)
        for key in _INPUTS
    }
    outcome = scratch / "outcome.json"
    order = Order(
        **local,  # type: ignore[arg-type]  # poses is never None
        config=str(write_config(options, scratch / "run.toml")),
        output=str(folder),
        outcome=str(outcome),
    )
    threads = str(options.sfm.threads)
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-m", "handeye_fg.batching.one"],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            env={**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads},
            # The lock is held until this process has ended, whatever happens to the worker.
            pass_fds=() if lock is None else (lock.fileno(),),
            # Ctrl-C in a terminal is for the batch, which then ends its calibrations.
            start_new_session=True,
        )
        try:
            end = _ended(process, json.dumps(asdict(order)), job.timeout_s, wanted)
        finally:
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()
    if (folder / LOG).stat().st_size == 0:
        (folder / LOG).unlink()
    if end is None and outcome.is_file():
        return dict(json.loads(outcome.read_text(encoding="utf-8")))
    return {"status": "failed", "message": end or _crash(process.returncode, folder / LOG)}


def _ended(
    process: "subprocess.Popen[bytes]", order: str, timeout_s: float, wanted: Callable[[], bool]
) -> str | None:
    """Wait for the process; why it has to be ended, or None where it ends by itself."""
    until = time.monotonic() + timeout_s
    try:
        if process.stdin is not None:
            process.stdin.write(f"{order}\n".encode())
            process.stdin.flush()
    except BrokenPipeError:
        pass  # it has ended before it began: its exit code says how
    while True:
        try:
            process.wait(_POLL_S)
        except subprocess.TimeoutExpired:
            if time.monotonic() > until:
                return (
                    f"the calibration was not done after {timeout_s:g} s and was ended; give it more "
                    "time (--timeout) or look for what blocks"
                )
            if not wanted():
                return "the batch was interrupted"
        else:
            return None


def _crash(code: int, log: Path) -> str:
    """How a calibration ended that has not said so itself."""
    text = log.read_text(encoding="utf-8", errors="backslashreplace") if log.exists() else ""
    last = next((line.strip() for line in reversed(text.split("\n")) if line.strip()), "")
    if code == -signal.SIGKILL:
        how = "was killed, most likely since memory ran out"
    elif code < 0:
        how = f"crashed by signal {-code} ({signal.strsignal(-code)})"
    else:
        how = f"ended with code {code} and without a result ({last[:200]})"
    where = f"see {LOG} in its folder, and " if text else ""
    return f"the calibration {how}; {where}try this data set alone"


def _drift(result: Result, reference: str, significance: float, scratch: Path) -> Comparison:
    """Hold the result against an earlier one."""
    if sources.is_url(reference) and not reference.endswith(".json"):
        reference = f"{reference.rstrip('/')}/{FILE_NAME}"
    earlier = load_result(Path(sources.fetched(reference, scratch / "reference")))
    return compare(earlier, result, significance=significance)
