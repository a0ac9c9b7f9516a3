"""An unusable cluster is rejected in one line with the remedy."""

from __future__ import annotations

import threading
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import pytest

from haptorb import cluster
from haptorb.child_process import count_cores
from haptorb.cluster import check_versions, list_versions, open_cluster, run_jobs
from haptorb.errors import InputError

# Importing it takes most of a second, in every process that collects tests.
pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere at all", "nowhere", "ftp://127.0.0.1:9"])
def test_a_scheduler_that_is_not_there_is_told_in_one_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(InputError, match="Dask scheduler") as told, open_cluster(address):
        pass
    assert f"'{address}'" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_without_workers_says_how_to_start_some() -> None:
    import distributed

    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as made,
        pytest.raises(InputError, match=f"dask worker {made.scheduler_address}"),
        open_cluster(made.scheduler_address),
    ):
        pass


class OtherCluster:
    """A client of a cluster some of whose computers have another version of something."""

    def __init__(self, whose: str, package: str, version: str | None) -> None:
        self._other = (whose, package, version)

    def get_versions(self, packages: Any) -> dict[str, Any]:
        same = {
            **list_versions(),
            "python": "3.11.2.final.0",
            "dask": "8.0",
            "distributed": "8.0",
            "cloudpickle": "3.1",
        }
        whose, package, version = self._other

        def tell(name: str) -> dict[str, Any]:
            return {"packages": {**same, **({package: version} if whose == name else {})}}

        return {"client": tell("client"), "scheduler": tell("scheduler"), "workers": {"w": tell("workers")}}

    def run(self, look: Any, on_error: str) -> dict[str, Any]:
        assert look() == list_versions()["haptorb"]
        absent = self._other == ("workers", "haptorb", None)
        return {"w": ImportError("No module named haptorb") if absent else look()}


@pytest.mark.parametrize(
    ("whose", "package", "version", "message"),
    [
        ("scheduler", "distributed", "7.0", "scheduler at 'tcp://a:1' has distributed 7.0, this computer has 8.0"),
        ("scheduler", "python", "3.10.1.final.0", "scheduler at 'tcp://a:1' has Python 3.10, this computer has 3.11"),
        ("workers", "numpy", "1.0", "workers at 'tcp://a:1' have numpy 1.0, this computer has"),
        ("workers", "haptorb", None, "workers at 'tcp://a:1' have haptorb (missing), this computer has"),
    ],
)
def test_another_version_is_refused_with_both(whose: str, package: str, version: str | None, message: str) -> None:
    with pytest.raises(InputError) as told:
        check_versions(OtherCluster(whose, package, version), "tcp://a:1")
    assert message in str(told.value)
    check_versions(OtherCluster("scheduler", "numpy", None), "tcp://a:1")  # which only hands jobs on
    check_versions(OtherCluster("workers", "python", "3.11.9.final.0"), "tcp://a:1")


class Cluster:
    """A client of one computer that computes each job when it gets it; it notes the threads that ask it."""

    status = "running"
    scheduler = SimpleNamespace(address="tcp://127.0.0.1:8786")

    def __init__(self) -> None:
        self.asked: list[threading.Thread] = []

    def nthreads(self) -> dict[str, int]:
        self.asked.append(threading.current_thread())
        return {"w": 1}

    def map(self, call: Any, jobs: list[Any], pure: bool) -> list[Any]:
        return [Computed(self, job) for job in jobs]

    def cancel(self, futures: list[Any]) -> None:
        self.asked.append(threading.current_thread())


class Computed:
    """The result of a job, which is the job."""

    def __init__(self, client: Cluster, job: Any) -> None:
        self._client, self._job = client, job

    def add_done_callback(self, tell: Any) -> None:
        tell(self)

    def result(self) -> Any:
        self._client.asked.append(threading.current_thread())
        return self._job


def test_no_signal_arrives_inside_a_call_of_distributed() -> None:
    """Python runs handlers of signals in the main thread only. In a call of distributed, one makes it print a traceback
    beside the program's own message."""
    client = Cluster()
    assert list(run_jobs(client, count_cores, range(5))) == [0, 1, 2, 3, 4]
    half = run_jobs(client, count_cores, range(5))
    next(half)
    half.close()
    assert len(client.asked) > 8
    assert threading.main_thread() not in client.asked
