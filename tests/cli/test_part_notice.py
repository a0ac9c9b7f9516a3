"""The terminal reports once which rendered part is unavailable."""

import time

from haptorb.cli.run import notify_rendered_part


class Turning:
    """A servo whose world asks for torque after a while."""

    render = None
    part_remarks = ("of force", "of torque", "of both")

    def __init__(self, *parts):
        self.parts = list(parts)

    @property
    def rendered_part(self):
        return self.parts.pop(0) if len(self.parts) > 1 else self.parts[0]


def test_each_part_is_told_once(capsys, monkeypatch):
    monkeypatch.setattr("haptorb.cli.run._CHECK_INTERVAL_S", 1e-3)
    servo = Turning(None, "force", "torque", "torque", "both", "torque", "both")
    with notify_rendered_part(servo):
        while len(servo.parts) > 1:
            time.sleep(1e-3)
    assert capsys.readouterr().err.split("\n") == ["of torque", "of both", ""]


def test_force_is_told_where_it_was_chosen(capsys):
    servo = Turning("force")
    servo.render = "force"
    with notify_rendered_part(servo):
        pass
    assert capsys.readouterr().err == "of force\n"
