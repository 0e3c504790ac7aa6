"""Put tables and pictures of a report into the README and docs: `python docs/publish.py`.

After `gpf repro --profile full`. Pictures are copied from results/figures; tables stand between
marks such as `<!-- table_1_psnr -->` and `<!-- /table_1_psnr -->`.
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

PROFILE = "full"

FIGURES = Path("results/figures")
IMAGES = Path("docs/images")
FILMS = ("water_caustic_2",)
PICTURES = ("teaser", "cumulative_cost", "quality_time", "comparison_water_caustic_2")

# In a footnote, or a remark; a system that cannot serve a scene has another reason.
_UNFINISHED = re.compile(r"^(?:<sup>.*\bnot run\b|Not .*\byet\b|On file, but)", re.MULTILINE)
_MARKS = re.compile(r"<!-- (\w+) -->\n.*?<!-- /\1 -->", re.DOTALL)


def main() -> None:
    """Publish what there is: all of it, or with an exit code of 2 nothing."""
    try:
        publish(Results.open())
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def publish(results: Results) -> None:
    """Copy the pictures and fill in the tables; one that is missing is an error."""
    refuse_other_sizes(results)
    if results.unmeasured:
        raise UserError(
            str(results.root),
            f"has no numbers of {join(results.unmeasured)} with {results.passes} passes",
            f"Run `gpf repro --profile {PROFILE}` to its end.",
        )
    copies = {FIGURES / f"{name}.png": IMAGES / f"{name}.png" for name in PICTURES}
    copies |= {
        results.scene(name).folder / "animation" / "animation.webp": IMAGES / f"{name}.webp"
        for name in FILMS
    }
    for source in copies:
        if not source.exists():
            raise UserError(str(source), "is missing", f"Run `gpf repro --profile {PROFILE}`.")
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


def refuse_other_sizes(results: Results) -> None:
    """Raise an error where params.yaml is not as the pages say that it was."""
    for key, wanted in read_profiles()[PROFILE].items():
        section, leaf = key.split(".")
        found = getattr(getattr(results.params, section), leaf)
        found = list(found) if isinstance(found, tuple) else found
        if wanted != EVERY and found != wanted:
            todo = f"Run `gpf profile {PROFILE}` and `gpf repro`: the pages speak of that."
            raise UserError(f"params.yaml: {key}", f"is {found}, not {wanted}", todo)


def fill(name: str, results: Results) -> str:
    """The marks of a table, and the table between them."""
    if name == "summary":
        body = summary(results)
    else:
        file = results.root / "tables" / f"{name}.md"
        if not file.exists():
            raise UserError(str(file), "is missing", f"Run `gpf repro --profile {PROFILE}`.")
        # Without the title, which the page has as a heading of its own.
        body = file.read_text(encoding="utf-8").split("\n", 2)[2].strip()
        if _UNFINISHED.search(body):
            todo = f"Run `gpf repro --profile {PROFILE}` to its end."
            raise UserError(str(file), "lacks what has not been run", todo)
    return f"<!-- {name} -->\n{body}\n<!-- /{name} -->"


def summary(results: Results) -> str:
    """A line per scene: how good the field is, and what it costs."""
    passes = results.params.reference.passes
    lines = [
        f"| scene | PSNR | a second SPPM, {passes} passes | as good as SPPM with | a view takes "
        f"| by SPPM, {passes} passes | preparation | pays from |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in results.scenes:
        scene = results.scene(name)
        words = describe_scene(results, scene)
        second = results.row(name, SECOND_REFERENCE)["psnr"]
        field = results.row(name, FIELD)["psnr"]
        lines.append(
            f"| {scene.title} | **{field:.1f}** | {second:.1f} | {words.worth} passes "
            f"| {words.seconds} | {words.sppm_seconds} | {words.preparation} "
            f"| {words.breaks_even} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
