"""All figures of a study for a paper, and a file of captions: written together or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.figure import Figure

from haptorb.apps.study.analysis.analysis import Analysis
from haptorb.apps.study.analysis.drawings import conditions as drawn
from haptorb.apps.study.analysis.drawings.identification import (
    draw_identification,
    draw_latitude_error,
    is_published_layout,
)
from haptorb.apps.study.analysis.drawings.style import PaperSize, use_paper_style
from haptorb.errors import InputError, RecordingError
from haptorb.files.replace_together import replace_files
from haptorb.files.text_file import read_text
from haptorb.version import __version__

__all__ = ["KINDS", "draw_figures", "write_figures"]

KINDS = ("pdf", "svg", "png")
_Entry = tuple[str, Callable[[Analysis, PaperSize], Figure], str]


def draw_figures(analysis: Analysis, size: PaperSize | None = None) -> dict[str, tuple[Figure, str]]:
    """Name → figure and caption, for what this study has."""
    size = size or PaperSize()
    with use_paper_style():
        return {name: (draw(analysis, size), caption) for name, draw, caption in _list_figures(analysis)}


def write_figures(
    analysis: Analysis, folder: str | Path, kind: str = "pdf", *, size: PaperSize | None = None, overwrite: bool = False
) -> tuple[Path, ...]:
    """NAME.`kind` for every figure, and captions.md, into `folder`; all files or none. Returns them.

    Raises InputError for another kind and for a study without figures, RecordingError if a file exists and `overwrite`
    is not set, or cannot be written.
    """
    if kind not in KINDS:
        raise InputError(f"figures can be {', '.join(KINDS)}; got '{kind}'")
    folder = Path(folder)
    found = draw_figures(analysis, size)
    if not found:
        raise InputError(f"study '{analysis.study.name}' has no answers to plot")
    files = [folder / f"{name}.{kind}" for name in found]
    captions = folder / "captions.md"
    text_of_captions = _write_captions(analysis, found)
    for path in (*files, captions):
        if path.exists() and not overwrite and not (path == captions and _has_text(path, text_of_captions)):
            text = f"{path} exists; choose another folder, or replace it"
            raise RecordingError(f"{text} with overwrite=True", command=f"{text} with --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replace_files([*files, captions]) as parts, use_paper_style():
            for part, (figure, _) in zip(parts, found.values(), strict=False):
                figure.savefig(part, format=kind, dpi=600, metadata=_describe_file(analysis, kind))
            parts[-1].write_text(text_of_captions, encoding="utf-8")
    except OSError as cause:
        raise RecordingError(f"{folder}: figures cannot be written ({cause.strerror or cause})") from cause
    return (*files, captions)


def _list_figures(analysis: Analysis) -> Iterator[_Entry]:
    people = "Points: means over participants; bars: 95 % over participants."
    if analysis.confusion is not None:
        form = " In the form of Zárate et al. 2020, Fig. 8." if is_published_layout(analysis) else ""
        yield (
            "identification", draw_identification,
            "Left: answered against prompted set-point, mean over participants. Right: set-points from above; shade: "
            f"share of correct answers; arrows: a third or more of the wrong answers went there.{form}",
        )  # fmt: skip
    if analysis.rings:
        beside = " Left: as printed in Zárate et al. 2020, Fig. 9." if is_published_layout(analysis) else ""
        yield (
            "error-over-theta", draw_latitude_error,
            "Distance of the answered from the true position over θ, mean ± standard deviation over trials." + beside,
        )  # fmt: skip
    if analysis.curves:
        yield (
            "psychometric-curves", drawn.draw_curves,
            "Points: share of trials in which the comparison was called stronger, over all participants. Thin: "
            "function of each participant; thick: median participant of the group; bar near 0.5: 95 % of its "
            "threshold, an arrow where an end does not exist; vertical line: reference.",
        )  # fmt: skip
    if analysis.tracks:
        yield (
            "thresholds", drawn.draw_thresholds,
            "Grey: fitted thresholds of each participant with 95 % (arrow: no end), joined. Large points: mean of "
            "the group in the logarithm, 95 %.",
        )  # fmt: skip
    if analysis.scores:
        yield "ratings", drawn.draw_ratings, f"Ratings by condition. {people}"
    if analysis.chosen:
        yield "choices", drawn.draw_choices, "Share of trials in which the first was chosen, 95 %; line: no preference."
    if analysis.magnitudes:
        yield (
            "magnitudes", drawn.draw_magnitudes,
            "Geometric means over participants of their estimates, each divided by the value of the participant's "
            "power law at the reference in the first condition; bars: Student's 95 % (logarithm); lines: mean law.",
        )  # fmt: skip
    if analysis.times:
        yield (
            "response-times",
            drawn.draw_response_times,
            f"Response times by condition, geometric means. {people}",
        )


def _has_text(path: Path, text: str) -> bool:
    """Whether the file is that text: the same figures in another format have the same captions."""
    try:
        return read_text(path, "captions", InputError) == text
    except InputError:
        return False


def _describe_file(analysis: Analysis, kind: str) -> dict[str, str | None]:
    """What the file says of itself; without a date, so that the same answers give the same file."""
    title = f"{analysis.study.name}{' (SIMULATED)' if analysis.marked else ''}"
    made = f"haptorb {__version__}"
    if kind == "pdf":
        return {"Title": title, "Subject": analysis.origin, "Creator": made, "CreationDate": None}
    if kind == "svg":
        return {"Title": title, "Description": analysis.origin, "Creator": made, "Date": None}
    return {"Title": title, "Description": analysis.origin, "Software": made}


def _write_captions(analysis: Analysis, found: dict[str, tuple[Figure, str]]) -> str:
    head = f"# Figures of study {analysis.study.name}\n\n{analysis.origin}. {analysis.trials} trials.\n"
    return head + "".join(f"\n**{name}.** {caption}\n" for name, (_, caption) in found.items())
