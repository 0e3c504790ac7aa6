"""Descriptions of an imported scene, for the terminal and for the README.md in its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from stages.importing.report import ImportReport, SceneReport

_LISTED = 8


def print_report(report: ImportReport, console: Console | None = None) -> None:
    """Print one line per fact, then one line per warning."""
    console = console or Console()
    folder = report.folder
    if folder.is_relative_to(Path.cwd()):
        folder = folder.relative_to(Path.cwd())
    console.print(Text(f"{folder}: imported from {report.origin}", "bold"), soft_wrap=True)
    facts = [("files", describe_files(report)), *describe_facts(report.scene)]
    for name, detail in [*facts, ("views", describe_views(report))]:
        console.print(Text.assemble(f"  {name:<14}  {detail}"), soft_wrap=True)
    for warning in all_warnings(report):
        console.print(Text.assemble(("  note            ", "yellow"), warning), soft_wrap=True)


def describe_scene(report: ImportReport, folder: Path) -> str:
    """The text of a README.md, which names the licence files found in ``folder``."""
    papers = [p.name for p in sorted(folder.iterdir()) if p.name.lower().startswith(("lic", "cop"))]
    licence = f"see {', '.join(f'`{name}`' for name in papers)}"
    lines = [
        f"# {report.name}",
        "",
        f"Imported from `{report.origin}`.",
        "",
        f"- Licence: {licence if papers else 'unknown; to be filled in'}.",
        "- Author and origin: to be filled in.",
        "",
        "Found during the import:",
        "",
        *(f"- {name}: {detail}" for name, detail in describe_facts(report.scene)),
        *(f"- Note: {warning}." for warning in all_warnings(report)),
    ]
    return "\n".join(lines) + "\n"


def all_warnings(report: ImportReport) -> list[str]:
    """The warnings about the files, then those about the scene."""
    return [*report.warnings, *report.scene.warnings]


def describe_files(report: ImportReport) -> str:
    """The number of copied files, and their size."""
    return f"{report.files} copied, {report.size / 1e6:.1f} MB"


def describe_views(report: ImportReport) -> str:
    """The numbers of training views, novel views and frames."""
    train, novel = len(report.views.train), len(report.views.novel)
    frames = len(report.views.frames())
    path = f", a path of {frames} frames" if frames else ", no path"
    return f"{train} for training, {novel} novel{path}"


def describe_facts(scene: SceneReport) -> list[tuple[str, str]]:
    """The facts found about a scene: pairs of a heading and a line."""
    emitters = ", ".join(f"{number} {kind}" for kind, number in scene.emitters.items())
    facts = [("emitters", emitters)]
    for use in ("queried", "traced through", "both", "unsupported"):
        kinds: dict[str, list[str]] = {}
        for material in scene.materials:
            if material.use == use:
                kinds.setdefault(material.kind, []).append(material.name)
        if kinds:
            parts = [f"{kind}: {_enumerate(names)}" for kind, names in kinds.items()]
            facts.append((use, "; ".join(parts)))
    size = " × ".join(f"{length:.4g}" for length in scene.size)
    return [
        *facts,
        ("size", f"{size} units, diagonal {scene.diagonal:.4g}"),
        ("camera", f"median distance to what it sees: {scene.camera_distance:.4g} units"),
        ("photons", f"{100 * scene.landing:.3g}% of photon paths reach a diffuse surface"),
        (
            "radii",
            f"kernel {scene.initial_radius:.3g} for {scene.photons:,} photon paths per pass, "
            f"search {scene.search_radius:.3g} for {scene.photons:,} Gaussians",
        ),
    ]


def _enumerate(names: Sequence[str]) -> str:
    rest = len(names) - _LISTED
    more = f" and {rest} more" if rest > 0 else ""
    return ", ".join(names[:_LISTED]) + more
