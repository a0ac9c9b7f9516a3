"""A cluster that cannot be used is refused in one line that says what to do."""

from __future__ import annotations

import pytest

from haptorb.cluster import dask_cluster
from haptorb.cluster.dask_cluster import open_cluster
from haptorb.errors import InputError

distributed = pytest.importorskip("distributed")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere at all", "nowhere", "ftp://127.0.0.1:9"])
def test_a_scheduler_that_is_not_there_is_told_in_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dask_cluster, "_PATIENCE", 0.3)
    with pytest.raises(InputError, match="Dask scheduler") as told, open_cluster(address):
        pass
    assert f"'{address}'" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_without_workers_says_how_to_start_some() -> None:
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as made,
        pytest.raises(InputError, match=f"dask worker {made.scheduler_address}"),
        open_cluster(made.scheduler_address),
    ):
        pass
