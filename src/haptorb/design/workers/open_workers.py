"""The workers that a command asks for: a cluster, or processes of this computer."""

from __future__ import annotations

from contextlib import AbstractContextManager

from haptorb.design.design import Design
from haptorb.design.workers.processes import open_processes
from haptorb.design.workers.workers import Workers
from haptorb.errors import InputError

__all__ = ["open_workers"]


def open_workers(
    design: Design, processes: int | None = None, scheduler: str | None = None
) -> AbstractContextManager[Workers]:
    """Workers for the candidates of `design`, until the block ends: one process per core by default.

    scheduler  address of a Dask scheduler, such as tcp://127.0.0.1:8786: compute on its cluster
    """
    if scheduler is None:
        return open_processes(design, processes)
    if processes is not None:
        raise InputError("processes are those of this computer: leave them out with a scheduler")
    from haptorb.design.workers.cluster import open_cluster_workers

    return open_cluster_workers(design, scheduler)
