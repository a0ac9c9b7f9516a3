"""Simulated participants are bit-identical in all kinds of worker; errors are one line."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from haptorb.errors import InputError
from haptorb_study.simulated.power import simulate_pool
from haptorb_study.study_file import study_of

STUDY = study_of(
    'name = "two"\nprocedure = "localisation"\n[set_points]\n'
    "points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n[trials]\nrepetitions = 1\n"
    '[[conditions]]\nname = "base"\n[[conditions]]\nname = "weak"\nparameters = { moment = 0.05 }'
)
POOL, SEED = 4, 5


def simulate(**options: object) -> list[float]:
    return simulate_pool(STUDY, POOL, SEED, "error", ("base", "weak"), **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def alone() -> list[float]:
    return simulate()


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """A Dask cluster of two processes on this computer."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0
    ) as made:
        yield made.scheduler_address


@pytest.mark.slow  # two processes of a design search: tests/design/workers/test_processes.py
def test_two_processes_give_what_one_gives(alone: list[float]) -> None:
    told: list[tuple[int, int]] = []
    assert simulate(processes=2, progress=lambda done, of: told.append((done, of))) == alone
    assert len(set(alone)) == POOL
    assert told[-1] == (POOL, POOL)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_what_one_process_gives(alone: list[float], cluster: str) -> None:
    assert simulate(scheduler=cluster) == alone


def test_no_process_at_all_is_refused() -> None:
    with pytest.raises(InputError, match="processes must be 1 or more"):
        simulate(processes=0)
