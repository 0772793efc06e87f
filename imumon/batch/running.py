"""Tasks to the workers of Dask, their results back, in bounded numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import islice
from typing import Any

from imumon.batch.dataset import Row
from imumon.batch.tasks import Job, failure, work
from imumon.errors import ImumonError, Reason, missing_package

AHEAD = 50
"""Tasks a worker has before it: enough to have one at once when another ends, few enough that the scheduler
knows of thousands when there are millions."""
FEWEST_AHEAD = 200
CONNECT_S = 10.0
RESTART_S = 24 * 3600.0
"""How long a worker that died here may take to come back.

It is begun anew at once.  On a busy machine that takes longer than Dask's 15 s, after which it would be given
up, and with the last one the batch would wait for ever.
"""
LOCALHOST = "127.0.0.1"


@contextmanager
def workers(scheduler: str | None, number: int) -> Iterator[Any]:
    """Give a client of the scheduler at this address, or of a cluster of processes here.

    Raises BAD_CONFIG when Dask is not there; NOT_FOUND when nobody answers at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise missing_package("a batch", "distributed", "batch") from error
    if scheduler is None:
        with (
            dask.config.set({"distributed.deploy.lost-worker-timeout": RESTART_S}),
            LocalCluster(
                n_workers=number,
                threads_per_worker=1,
                dashboard_address=f"{LOCALHOST}:0",  # any port: another batch may run
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise ImumonError(
            Reason.NOT_FOUND, f"no scheduler at {scheduler}: {error}", "start one: dask scheduler"
        ) from error
    with client:
        yield client


def run_jobs(
    client: Any,
    jobs: Iterable[Job],
    take: Callable[[Sequence[Row]], object],
    do: Callable[[Job], Sequence[Row]] = work,
) -> None:
    """Do all jobs, in the order in which they end; `take` is given the rows of each.

    The tasks of a worker that dies are done by another one; a task with which several die has failed.
    """
    from distributed import as_completed

    left = iter(jobs)
    ahead = max(FEWEST_AHEAD, AHEAD * sum(client.nthreads().values()))
    running: dict[Any, Job] = {}

    def begin(count: int) -> list[Any]:
        begun = {client.submit(do, job, pure=False): job for job in islice(left, count)}
        running.update(begun)
        return [*begun]

    ended = as_completed(begin(ahead))
    for batch in ended.batches():
        for future in batch:
            take(_rows(future, running.pop(future)))
        ended.update(begin(len(batch)))


def _rows(future: Any, job: Job) -> Sequence[Row]:
    """Return the rows of a task that has ended in whatever way.

    Whether it has is for `result` to say: the rows of one that ended are lost when the worker that holds them
    dies before they are fetched, and then are made again.
    """
    from distributed.scheduler import KilledWorker

    try:
        rows: Sequence[Row] = future.result()
    except CancelledError:
        return [failure(job.place, "lost", "the scheduler has forgotten the task")]
    except KilledWorker:
        return [failure(job.place, "worker died", "each of several workers died with this session")]
    except Exception as error:  # noqa: BLE001 whatever a session met is its failure, not the batch's
        return [failure(job.place, "defect", f"{type(error).__name__}: {error}")]
    return rows
