"""``batch``: many data sets, on this machine or on a Dask cluster."""

import logging
import secrets
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path

import dask
from dask.system import CPU_COUNT
from distributed import Client, LocalCluster, as_completed, get_worker
from distributed.system import MEMORY_LIMIT
from distributed.utils import silence_logging_cmgr

from handeye_fg.batching import sources, summary
from handeye_fg.batching.manifest import DataSet, checked, read_data_sets
from handeye_fg.batching.rows import Batch, Row
from handeye_fg.batching.task import Job, run_data_set
from handeye_fg.errors import HandEyeError, InputDataError
from handeye_fg.io.fields import reason
from handeye_fg.options import Options
from handeye_fg.progress import Progress, silent

_LOG = logging.getLogger(__name__)
# What a calibration takes of memory, roughly; a batch that asks for no number of jobs leaves that much.
_BYTES_PER_JOB = 2 * 2**30
_CONNECT_S = 20
# The workers in this process wait for others, minutes at a time. No page of Dask's is served: nothing but this process
# has business with its scheduler; and with its clocks, which look every few milliseconds, it takes 7 % of a core.
_QUIET: dict[str, object] = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
}


def batch(
    source: str | Path | Sequence[DataSet],
    output: str | Path,
    *,
    jobs: int | None = None,
    scheduler: str | Client | None = None,
    options: Options | None = None,
    reference: str | Path | None = None,
    significance: float = 0.001,
    timeout_s: float = 3600.0,
    progress: Progress = silent,
) -> Batch:
    """Calibrate many data sets, each in a process of its own: none harms another.

    What is done already, with the same input, options and version, is kept: a batch that was interrupted
    goes on where it was, and one of which little has changed does little. Data sets that failed are done again.
    ``output`` gets a folder for each data set, ``summary.csv`` and ``summary.html``.

    Args:
        source: manifest (CSV or YAML), folder of folders, or data sets.
        output: folder or fsspec URL; workers on other machines must see the same.
        jobs: data sets at a time; None: as many as there are cores and memory, or places in the cluster.
        scheduler: address of a running Dask scheduler, such as ``tcp://10.0.0.5:8786``, or a client of it;
            None: workers in this process.
        options: of the data sets that name no file of their own; with ``sfm.threads`` at 0 the cores are
            divided among the jobs.
        reference: output of an earlier batch, to hold each data set against that of the same name; a
            data set's own ``reference`` wins.
        significance: probability below which a difference from an earlier calibration counts as drift.
        timeout_s: after so many seconds a data set has failed.
        progress: told how many data sets are done.

    Raises:
        InputDataError: the manifest breaks its form, the output cannot be written, or the scheduler does
            not answer; nothing was calibrated.
        HandEyeError: the scheduler was lost.

    Examples:
        Each data set is calibrated in a process of its own, so that this is not run here:

        >>> import handeye_fg as hf
        >>> found = hf.batch("cells", "out", jobs=2)  # doctest: +SKIP
        >>> [(row.name, row.status) for row in found.rows]  # doctest: +SKIP
    """
    if jobs is not None and jobs < 1:
        raise InputDataError(f"jobs is {jobs}, but must be 1 or more")
    if not 0.0 < significance < 1.0:
        raise InputDataError(f"significance is {significance}, but must be between 0 and 1")
    if not timeout_s > 0.0:
        raise InputDataError(f"timeout_s is {timeout_s}, but must be above 0")
    target = str(output) if sources.is_url(str(output)) else str(Path(output).absolute())
    if isinstance(source, str | Path):
        data_sets = read_data_sets(Path(source), None if sources.is_url(target) else Path(target))
    else:
        data_sets = checked(source)
    if reference is not None:
        data_sets = _against(data_sets, str(reference), target)
    most = min(jobs or _places(), len(data_sets))
    with ExitStack() as stack:
        sign = stack.enter_context(_signed(target))
        client = stack.enter_context(_client(scheduler, most))
        todo = (
            Job(
                data=data,
                output=target,
                sign=sign,
                options=options or Options(),
                timeout_s=timeout_s,
                significance=significance,
                threads=max(1, CPU_COUNT // most) if scheduler is None else 0,
            )
            for data in data_sets
        )
        done: dict[str, Row] = {}
        progress("data sets", 0, len(data_sets))
        for row in _rows(client, todo, None if jobs is None else most):
            done[row.name] = row
            progress("data sets", len(done), len(data_sets))
            problem = row.message if row.status == "failed" else row.drift_problem
            if problem:
                _LOG.warning("%s: %s", row.name, problem)
    result = Batch(rows=tuple(done[data.name] for data in data_sets))
    summary.write(result, target)
    return result


def _places() -> int:
    """How many calibrations this machine holds."""
    return max(1, min(CPU_COUNT, MEMORY_LIMIT // _BYTES_PER_JOB))


def _against(data_sets: Sequence[DataSet], reference: str, output: str) -> tuple[DataSet, ...]:
    """The data sets with the results of an earlier batch as references, where it has them."""
    earlier = reference if sources.is_url(reference) else str(Path(reference).absolute())
    if earlier.rstrip("/") == output.rstrip("/"):
        raise InputDataError(
            f"reference {reference} is the output folder, whose results are replaced; write to another one"
        )
    if not sources.exists(earlier):
        raise InputDataError(
            f"reference {reference}: no such folder; give that of an earlier batch"
        )
    return tuple(
        replace(data, reference=f"{earlier}/{data.name}")
        if data.reference is None and sources.exists(f"{earlier}/{data.name}/result.json")
        else data
        for data in data_sets
    )


@contextmanager
def _signed(output: str) -> Iterator[str]:
    """Make the output folder; yields the name of a file in it by which workers know it."""
    sign = f".batch-{secrets.token_hex(8)}"
    if sources.is_url(output):
        yield sign
        return
    path = Path(output) / sign
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        raise InputDataError(
            f"{output}: cannot be written ({error.strerror}); choose another output folder"
        ) from error
    try:
        yield sign
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def _client(scheduler: str | Client | None, jobs: int) -> Iterator[Client]:
    """A client of the scheduler, or of workers in this process that listen to it alone."""
    if isinstance(scheduler, Client):
        yield scheduler
        return
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputDataError(
                f"scheduler {scheduler}: does not answer ({reason(error)}); check the address"
            ) from error
        with silence_logging_cmgr(logging.CRITICAL), client:
            if not client.nthreads():
                _LOG.warning("%s has no worker yet; the batch waits for the first", scheduler)
            yield client
        return
    with (
        dask.config.set(_QUIET),
        LocalCluster(
            n_workers=1,
            threads_per_worker=jobs,
            processes=False,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.ERROR,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _rows(client: Client, todo: Iterator[Job], most: int | None) -> Iterator[Row]:
    """The rows as they come. No more jobs are handed over than are soon begun.

    Args:
        client: of the scheduler.
        todo: the jobs.
        most: at a time; None: as many as the cluster has places.
    """
    pending = as_completed(with_results=True, raise_errors=False, loop=client.loop)
    jobs: dict[str, Job] = {}

    def hand_over() -> None:
        # A few wait at the scheduler, so that no worker does, and a cluster that grows has a reason.
        room = most or 2 * sum(client.nthreads().values()) + 1
        for job in islice(todo, max(0, room - len(jobs))):
            key = f"{job.data.name}-{secrets.token_hex(4)}"
            future = client.submit(_on_worker, job, key=key, pure=False)
            jobs[key] = job
            pending.add(future)

    try:
        hand_over()
        for future, row in pending:
            job = jobs.pop(future.key)
            if isinstance(row, Row):
                yield row
            else:  # the worker itself was lost, and again when the job was given to another one
                yield _lost(job, row)
            future.release()
            hand_over()
    except OSError as error:
        raise HandEyeError(
            f"the scheduler was lost ({reason(error)}); begin the batch again: what is done is kept"
        ) from error
    finally:
        with suppress(OSError):
            client.cancel(list(pending.futures))


def _lost(job: Job, failure: object) -> Row:
    error = failure[1] if isinstance(failure, tuple) else failure
    text = reason(error) if isinstance(error, Exception) else str(failure)
    return Row(
        name=job.data.name,
        status="failed",
        message=f"the cluster could not do it ({text}); look at the logs of its workers",
        kept=False,
        seconds=0.0,
        worker="",
    )


def _on_worker(job: Job) -> Row:
    """Run in a thread of a Dask worker, as long as somebody wants the result."""
    worker = get_worker()
    key = worker.get_current_task()
    if job.threads == 0:
        job = replace(job, threads=max(1, CPU_COUNT // worker.state.nthreads))

    def wanted() -> bool:
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing"

    return run_data_set(job, wanted)
