"""Tasks to the workers of Dask, their results back, in bounded numbers."""

import logging
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from multiprocessing import resource_tracker
from typing import Any

from imumon.errors import ImumonError, Reason, missing_package

from .dataset import Row
from .tasks import Job, failure, work

AHEAD = 50
"""Tasks a worker has before it, as of four at least: enough to have one at once when another ends, few enough
that the scheduler knows of thousands when there are millions."""
CONNECT_S = 10.0
RESTART_S = 24 * 3600.0
"""How long a worker that died here may take to come back.

It is begun anew at once.  On a busy machine that takes longer than Dask's 15 s, after which it would be given
up, and with the last one the batch would wait for ever.
"""


@contextmanager
def workers(scheduler: str | None, number: int) -> Iterator[Any]:
    """Give a client of the scheduler at this address, or of a cluster of processes here.

    Raises BAD_CONFIG when Dask is not there; NOT_FOUND when nothing answers at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
        from distributed.utils import silence_logging_cmgr
    except ImportError as error:
        raise missing_package("a batch", "distributed", "batch") from error
    if scheduler is None:
        with dask.config.set({"distributed.deploy.lost-worker-timeout": RESTART_S}):
            # Threads and processes that begin here take no Ctrl-C: a terminal sends it to the workers, too.
            # They inherit the mask, also a worker that such a thread begins anew later.  The tracker of
            # multiprocessing would lift it, were it begun with the first worker.
            resource_tracker.ensure_running()
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                cluster = LocalCluster(
                    n_workers=number,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",  # any port: another batch may run
                    silence_logs=logging.CRITICAL,
                )
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            with cluster, Client(cluster) as client:
                yield client
        return
    with silence_logging_cmgr(logging.CRITICAL):
        try:
            client = Client(scheduler, timeout=CONNECT_S)
        except (OSError, ValueError) as error:
            raise ImumonError(
                Reason.NOT_FOUND, f"no scheduler at {scheduler}: {error}", "start one: dask scheduler"
            ) from error
        with client:
            yield client


def run_jobs(client: Any, jobs: Iterable[Job], take: Callable[[Sequence[Row]], object]) -> None:
    """Do all jobs, in the order in which they end; `take` is given the rows of each.

    The tasks of a worker that dies are done by another one; a task with which several die has failed.

    Raises LOST where the scheduler has lost a task: that is no failure of its session.
    """
    from distributed import as_completed

    left = iter(jobs)
    ahead = AHEAD * max(4, sum(client.nthreads().values()))
    running: dict[Any, Job] = {}

    def begin(count: int) -> list[Any]:
        begun = {client.submit(work, job, pure=False): job for job in islice(left, count)}
        running.update(begun)
        return list(begun)

    ended = as_completed(begin(ahead))
    for batch in ended.batches():
        for future in batch:
            take(_rows(future, running.pop(future)))
        ended.update(begin(len(batch)))


def _rows(future: Any, job: Job) -> Sequence[Row]:
    """Return the rows of a task that has ended in whatever way.

    Whether it has, `result` states: the rows of one that ended are lost when the worker that holds them
    dies before they are fetched, and then are made again.

    Raises LOST where the scheduler has lost the task.
    """
    from distributed.scheduler import KilledWorker

    try:
        rows: Sequence[Row] = future.result()
    except KilledWorker:
        return [failure(job.place, "worker died", "each of several workers died with this session")]
    except Exception as error:
        if future.status != "error":
            raise ImumonError(
                Reason.LOST,
                "the scheduler has lost the tasks of this batch: it ended, or was started anew",
                "what is done is kept; with a scheduler that runs, the same command does the rest",
            ) from error
        # Whatever a session met is its failure, not the batch's.
        return [failure(job.place, "defect", f"{type(error).__name__}: {error}")]
    return rows
