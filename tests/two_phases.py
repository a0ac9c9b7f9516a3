"""How several pytest processes share the tests: what only computes side by side, then what runs beside a clock alone.

A browser, an emulator or a servo that loses its processor to another test fails for no fault of its own. So no such
test begins before every process but one has ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import PurePath
from typing import Any

from xdist.scheduler import LoadScopeScheduling


class TwoPhases(LoadScopeScheduling):
    """Whole files for each process, the heaviest first.

    alone      says of a file whether it waits for the second phase
    heavy      names of files, or of folders that are given out whole, because their files share what one of them made
    """

    def __init__(self, config: Any, log: Any, alone: Callable[[str], Any], heavy: Iterable[str]) -> None:
        super().__init__(config, log)
        self._alone = alone
        self._heavy = tuple(heavy)
        self._later: dict[str, dict[str, bool]] = {}  #: the second phase, until it begins
        self._second = False

    @property
    def tests_finished(self) -> bool:
        return not self._later and super().tests_finished

    @property
    def has_pending(self) -> bool:
        return bool(self._later) or super().has_pending

    def schedule(self) -> None:
        assert self.collection_is_completed
        if self.collection is None:
            if not self._check_nodes_have_same_collection():
                return  # told as an error of the run
            self.collection = list(next(iter(self.registered_collections.values())))
            files: dict[str, dict[str, bool]] = {}
            for nodeid in self.collection:
                files.setdefault(self._split_scope(nodeid), {})[nodeid] = False
            for file in sorted(files, key=self._weight):
                (self._later if self._alone(file) else self.workqueue)[file] = files[file]
        for node in self.nodes:
            self._reschedule(node)

    def remove_node(self, node: Any) -> str | None:
        """A process has ended. Returns the test that ended it, if one did; what it had before it goes to others."""
        files = self.assigned_work.pop(node)
        open_ = [(file, nodeid) for file, tests in files.items() for nodeid, done in tests.items() if not done]
        crashed = None
        if open_:
            file, crashed = open_[0]
            files[file][crashed] = True
            self.workqueue.update(files)
        for other in self.nodes:
            self._reschedule(other)
        return crashed

    def mark_test_pending(self, item: str) -> None:
        """Once more: a test that ended its process, and may try again."""
        self.workqueue.setdefault(self._split_scope(item), {})[item] = False

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::")[0]
        return next((part for part in PurePath(file).parent.parts if part in self._heavy), file)

    def _weight(self, file: str) -> int:
        name = PurePath(file).name
        return self._heavy.index(name) if name in self._heavy else len(self._heavy)

    def _reschedule(self, node: Any) -> None:
        """More work for a process; when the first phase has none left, all processes end but the last one."""
        if node.shutting_down:
            return
        others = [other for other in self.nodes if other is not node]
        if self._later and not self.workqueue:
            if any(not other.shutting_down for other in others):
                node.shutdown()
                return
            if others:  # at their last tests; `remove_node` comes back here
                return
            self.workqueue.update(self._later)
            self._later.clear()
            self._second = True
        if self._second and node is not self.nodes[0]:  # made in place of one that crashed
            node.shutdown()
            return
        # A process begins a test only when it knows the one after it, or that there is none.
        while self.workqueue and self._pending_of(self.assigned_work[node]) <= 2:
            self._assign(node)
        if not self.workqueue and not self._later:
            node.shutdown()

    def _assign(self, node: Any) -> None:
        file, tests = self.workqueue.popitem(last=False)
        self.assigned_work[node].setdefault(file, {}).update(tests)
        number = {nodeid: n for n, nodeid in enumerate(self.registered_collections[node])}
        node.send_runtest_some([number[nodeid] for nodeid, done in tests.items() if not done])
