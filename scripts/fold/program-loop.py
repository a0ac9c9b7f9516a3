def explain_missing(command: str, cause: ModuleNotFoundError) -> None:
    """Have `command` say in one line which package it needs, where that is not installed."""
    package = str(cause.name).partition(".")[0]

    @app.command(command, hidden=True, context_settings={"ignore_unknown_options": True, "allow_extra_args": True})
    def explain() -> None:
        raise InputError(f"`haptorb {command}` needs {package}, which is not installed")


for module in (run, view, show, check, recording, replay, calibrate, frame, fit, train, hardware):
    module.register(app)
for point in entry_points(group="haptorb.commands"):
    try:
        point.load().register(app)
    except ModuleNotFoundError as missing:
        explain_missing(point.name, missing)
