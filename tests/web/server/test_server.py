"""The serving thread keeps poses fresh: nothing of its own process holds it up."""

import gc

from haptorb.web.server import prioritize


def test_what_exists_is_not_searched_for_garbage_while_it_serves():
    gc.unfreeze()  # what other tests' loops have left in this process
    with prioritize():
        assert gc.get_freeze_count() > 10_000
        assert len(gc.get_objects()) < 1_000
    assert gc.get_freeze_count() == 0


def test_what_somebody_else_froze_stays_frozen():
    gc.freeze()
    try:
        with prioritize():
            pass
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
