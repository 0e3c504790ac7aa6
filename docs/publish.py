"""Put tables and pictures of the report into README.md and docs/: `python docs/publish.py`.

Run it after `gpf profile full && dvc repro` and `python -m benchmarks.pipeline independent`.
Pictures are copied from results/figures. Tables replace the text between marks such as
`<!-- table_1_psnr -->` and `<!-- /table_1_psnr -->`.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from shutil import copyfile

from gpf.core.errors import UserError
from gpf.core.files import write_text
from report.formats import join
from report.page.words import describe_scene
from report.results import FIELD, SECOND_REFERENCE, Results
from stages.commands.profiles import EVERY, read_profiles
from stages.common.makers import naming_commands

PROFILE = "full"
INDEPENDENT = "python -m benchmarks.pipeline independent"
ADVICE = f"Run `gpf profile {PROFILE} && dvc repro && {INDEPENDENT}` to its end."

FIGURES = Path("results/figures")
IMAGES = Path("docs/images")
FILMS = ("water_caustic_2",)
PICTURES = ("teaser", "cumulative_cost", "quality_time", "comparison_water_caustic_2")

# Footnotes and remarks of tables that are not complete. A system that cannot serve a scene has
# another reason.
_UNFINISHED = re.compile(r"^(?:<sup>.*\bnot run\b|Not .*\byet\b|On file, but)", re.MULTILINE)
_MARKS = re.compile(r"<!-- (\w+) -->\n.*?<!-- /\1 -->", re.DOTALL)


def main() -> None:
    """Publish everything; on an error publish nothing and exit with code 2."""
    try:
        with naming_commands():
            publish(Results.open())
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def publish(results: Results) -> None:
    """Copy the pictures and fill in the tables.

    Raises
    ------
    UserError: a picture or a table is missing or not complete; nothing has been written then.
    """
    check_profile(results)
    if results.unmeasured:
        raise UserError(
            str(results.root),
            f"has no numbers of {join(results.unmeasured)} with {results.passes} passes",
            ADVICE,
        )
    copies = {FIGURES / f"{name}.png": IMAGES / f"{name}.png" for name in PICTURES}
    copies |= {
        results.scene(name).folder / "animation" / "animation.webp": IMAGES / f"{name}.webp"
        for name in FILMS
    }
    for source in copies:
        if not source.exists():
            raise UserError(str(source), "is missing", ADVICE)
    pages = {}
    for page in (Path("README.md"), *sorted(Path("docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        pages[page] = text, _MARKS.sub(lambda match: fill(match[1], results), text)
    IMAGES.mkdir(parents=True, exist_ok=True)
    for source, copy in copies.items():
        copyfile(source, copy)
    for page, (old, new) in pages.items():
        if new != old:
            write_text(page, new)


def check_profile(results: Results) -> None:
    """Raise an error if params.yaml does not have the settings of the profile."""
    for key, wanted in read_profiles()[PROFILE].items():
        section, leaf = key.split(".")
        found = getattr(getattr(results.params, section), leaf)
        found = list(found) if isinstance(found, tuple) else found
        if wanted != EVERY and found != wanted:
            raise UserError(f"params.yaml: {key}", f"is {found}, not {wanted}", ADVICE)


def fill(name: str, results: Results) -> str:
    """The marks of a table with the table between them."""
    if name == "summary":
        body = summary(results)
    else:
        # That of INDEPENDENT lies outside of the report's own folder.
        folder = results.root if name == "independent" else results.root / "tables"
        file = folder / f"{name}.md"
        if not file.exists():
            raise UserError(str(file), "is missing", ADVICE)
        # Without the title: the page has its own heading.
        body = file.read_text(encoding="utf-8").split("\n", 2)[2].strip()
        if _UNFINISHED.search(body):
            raise UserError(str(file), "is not complete: some methods were not run", ADVICE)
    return f"<!-- {name} -->\n{body}\n<!-- /{name} -->"


def summary(results: Results) -> str:
    """A table with a line per scene: quality and cost of the field."""
    passes = results.params.reference.passes
    lines = [
        f"| scene | PSNR | a second SPPM, {passes} passes | as good as SPPM with "
        f"| a view takes | by SPPM, {passes} passes | preparation | pays from |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in results.scenes:
        scene = results.scene(name)
        words = describe_scene(results, scene)
        second = results.row(name, SECOND_REFERENCE)["psnr"]
        field = results.row(name, FIELD)["psnr"]
        lines.append(
            f"| {scene.title} | **{field:.1f}** | {second:.1f} | {words.equivalent_passes} passes "
            f"| {words.seconds} | {words.sppm_seconds} | {words.preparation} "
            f"| {words.breaks_even} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
