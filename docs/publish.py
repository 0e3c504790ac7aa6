"""Put tables and pictures of a report into the README and docs: `python docs/publish.py`.

After `gpf repro --profile full`. Pictures are copied from results/figures; tables stand between
marks such as `<!-- table_1_psnr -->` and `<!-- /table_1_psnr -->`.
"""

from __future__ import annotations

import re
from pathlib import Path
from shutil import copyfile

from gpf.artifacts import write_text
from gpf.errors import UserError
from report.page.words import describe_scene
from report.results import CEILING, FIELD, Results

PAGES = (Path("README.md"), *sorted(Path("docs").glob("*.md")))
FIGURES = Path("results/figures")
IMAGES = Path("docs/images")
PICTURES = ("teaser", "cumulative_cost", "quality_time", "comparison_water_caustic_2")

_MARKS = re.compile(r"<!-- (\w+) -->\n.*?<!-- /\1 -->", re.DOTALL)


def main() -> None:
    """Publish what there is; a table or picture that is missing is an error."""
    results = Results.open()
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name in PICTURES:
        source = FIGURES / f"{name}.png"
        if not source.exists():
            raise UserError(str(source), "is missing", "Run `gpf repro --profile full` first.")
        copyfile(source, IMAGES / source.name)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        new = _MARKS.sub(lambda match: fill(match[1], results), text)
        if new != text:
            write_text(page, new)


def fill(name: str, results: Results) -> str:
    """The marks of a table, and the table between them."""
    if name == "summary":
        body = summary(results)
    else:
        file = results.root / "tables" / f"{name}.md"
        if not file.exists():
            raise UserError(str(file), "is missing", "Run `gpf repro --profile full` first.")
        # Without the title, which the page has as a heading of its own.
        body = file.read_text(encoding="utf-8").split("\n", 2)[2].strip()
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
        ceiling = results.row(name, CEILING)["psnr"]
        field = results.row(name, FIELD)["psnr"]
        lines.append(
            f"| {scene.title} | **{field:.1f}** | {ceiling:.1f} | {words.worth} passes "
            f"| {words.seconds} | {words.sppm_seconds} | {words.preparation} "
            f"| {words.breaks_even} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
