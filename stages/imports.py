"""Which of the project's files decide what a stage writes: its own, and all that they import."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import gpf
from gpf.errors import UserError

PROJECT = Path(gpf.__file__).parent.parent
"""Where the packages lie, whatever the current folder is."""

PACKAGES = ("gpf", "stages", "metrics", "report")

# Whose change cannot change what a stage writes: they start things up, check, complain, report, or
# tell what code there is.
NO_INFLUENCE = frozenset(
    {
        "gpf/__init__.py",
        "gpf/config.py",
        "gpf/config_sections.py",
        "gpf/errors.py",
        "gpf/integrators/__init__.py",
        "gpf/runtime.py",
        "gpf/yaml_files.py",
        "metrics/__init__.py",
        "metrics/errors.py",
        "report/__init__.py",
        "stages/__init__.py",
        "stages/apart.py",
        "stages/cli.py",
        "stages/cluster.py",
        "stages/code.py",
        "stages/code_digest.py",
        "stages/imports.py",
        "stages/progress.py",
    }
)

# What a file reads, runs or has Mitsuba load by its name: no import tells of it.
TAKES_ALONG = {
    "gpf/baselines/official.py": ("gpf/baselines/programs/*.py",),
    "gpf/baselines/radiance_cache.py": ("gpf/integrators/gpf.py",),
    "gpf/baselines/sppm.py": ("gpf/integrators/sppm.py",),
    "report/page/page.py": ("report/page/*.css", "report/page/*.html", "report/page/*.js"),
    "report/paper.py": ("report/paper.yaml",),
    "stages/render.py": ("gpf/integrators/gpf.py",),
}


def closure(*files: str, without: Iterable[str] = ()) -> list[str]:
    """The files and all that they import, directly or not, sorted, but for those without influence.

    Names are relative to :data:`PROJECT`. What has no influence, or is in ``without``, passes none
    on.
    """
    idle = NO_INFLUENCE | set(without)
    done: set[str] = set()
    waiting = [*files]
    while waiting:
        file = waiting.pop()
        if file in done or file in idle:
            continue
        done.add(file)
        if file.endswith(".py"):
            waiting += imports_of(file)
        for pattern in TAKES_ALONG.get(file, ()):
            waiting += [_name(path) for path in PROJECT.glob(pattern)]
    return sorted(done)


@cache
def imports_of(file: str) -> frozenset[str]:
    """The project's files that one of its files imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(parse(PROJECT / file)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level or node.module is None:
                todo = "Name the whole module, from gpf, stages, metrics or report on."
                raise UserError(f"{file}:{node.lineno}", "imports relatively", todo)
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            found |= _files_of(name)
    return frozenset(found)


def parse(path: Path) -> ast.Module:
    """What a Python file says; a :class:`UserError` where it is none."""
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    except SyntaxError as error:
        where = f"{path}:{error.lineno}"
        raise UserError(where, f"is not Python ({error.msg})", "Mend it and try again.") from None


def _files_of(module: str) -> set[str]:
    """The file of a module of the project, and those of the packages that it is in."""
    parts = module.split(".")
    if parts[0] not in PACKAGES:
        return set()
    places = ["/".join(parts[:end]) for end in range(1, len(parts) + 1)]
    files = [file for place in places for file in (f"{place}.py", f"{place}/__init__.py")]
    return {file for file in files if (PROJECT / file).exists()}


def _name(path: Path) -> str:
    return path.relative_to(PROJECT).as_posix()
