"""Numbers of the papers from the registry of `haptorb reproduce`, their only implementation."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from haptorb_papers.reproduce import ReproductionResult


@pytest.fixture(scope="session")
def numbers(reproduction: Callable[[str, str], ReproductionResult]) -> Callable[..., list[float]]:
    """The computed numbers of some items of one reproduction, after a look that each of them holds."""

    def values_of(paper: str, name: str, *ids: str) -> list[float]:
        items = {item.id: item for item in reproduction(paper, name).items}
        chosen = [items[one] for one in ids]
        assert [item.id for item in chosen if item.verdict == "differs"] == []
        return [item.computed for item in chosen if item.computed is not None]

    return values_of


@pytest.fixture(scope="session")
def printed(reproduction: Callable[[str, str], ReproductionResult]) -> Callable[..., list[float]]:
    """What the paper prints for some items, evaluated."""

    def values_of(paper: str, name: str, *ids: str) -> list[float]:
        items = {item.id: item for item in reproduction(paper, name).items}
        return [items[one].published for one in ids if items[one].published is not None]

    return values_of
