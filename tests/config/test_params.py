"""params.yaml: what it may say, and the words for what it may not."""

import re
from pathlib import Path

import pytest
from pydantic import ValidationError
from ruamel.yaml import YAML

from gpf.core.errors import UserError
from stages.config.params import Params, read_params
from stages.config.titles import variant_title
from stages.references.views_with_images import count_needed_images

PROJECT = Path(__file__).parents[2]
GOOD = """\
scenes: [cornell_box]
film:
  height: 16
reference:
  passes: 4
  initial_radius: auto
field:
  search_radius: 0.25
train:
  rates:
    means: 0.002
"""


def read(tmp_path: Path, text: str) -> Params:
    file = tmp_path / "params.yaml"
    file.write_text(text, encoding="utf-8")
    return read_params(file)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("{spp: {system: path_tracer, spq: 3}}", "baselines.spp.spq: is an unknown key. Did"),
        ("{mine: {system: path_tracer, spq: 3}}", "baselines.mine.spq: is an unknown key. Did"),
        ("{mine: {system: path_tracer, spp: -3}}", "baselines.mine.spp: is -3. Input should be"),
        ("{mine: {system: nerf}}", "baselines.mine: is {'system': 'nerf'}. Input tag 'nerf'"),
    ],
)
def test_rows_are_named_as_the_file_has_them(tmp_path, more, words):
    """Even where a row is called like one of its keys."""
    with pytest.raises(UserError, match=re.escape(words)):
        read(tmp_path, f"{GOOD}baselines: {more}\n")


@pytest.mark.parametrize(
    ("row", "group", "fitting"),
    [
        ("{system: path_tracer, spp: equal_time}", "classical", "equal_time"),
        ("{system: path_tracer, spp: equal_time}", "learned", "equal_time"),
        ("{system: radiance_cache}", "classical", "learned"),
        ("{system: splatting}", "equal_time", "learned"),
        ("{system: path_tracer, spp: 4}", "equal_time", "classical or methods.learned"),
    ],
)
def test_methods_are_listed_where_the_pipeline_waits_for_what_they_need(
    tmp_path, row, group, fitting
):
    words = f"methods.{group} lists mine, which does not belong there. List it under methods."
    with pytest.raises(UserError, match=re.escape(words + fitting)):
        read(tmp_path, f"{GOOD}baselines: {{mine: {row}}}\nmethods: {{{group}: [mine]}}\n")


def test_what_is_left_out_has_its_default(tmp_path):
    params = read(tmp_path, GOOD)
    assert params.scenes == ("cornell_box",)
    assert (params.film.height, params.reference.passes) == (16, 4)
    assert (params.reference.initial_radius, params.field.search_radius) == ("auto", 0.25)
    assert (params.reference.alpha, params.field.k, params.train.rates.means) == (0.7, 3, 2e-3)
    assert params.runtime.variant == "auto"


def test_params_do_not_change(tmp_path):
    params = read(tmp_path, GOOD)
    with pytest.raises(ValidationError, match="frozen"):
        params.film.height = 8


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "passes:",
            "pases:",
            r"reference\.pases: .* mean 'passes'\? Known keys are alpha, direct",
        ),
        ("film:", "films:", r"films: is an unknown key\. Did you mean 'film'"),
        ("means: 0.002", "mean: 1", r"train\.rates\.mean: is an unknown key\. Did you mean"),
        ("means: 0.002", "means: -1", r"train\.rates\.means: is -1\. .*greater than or eq"),
        ("means: 0.002", "means: .nan", r"train\.rates\.means: is nan\. Input should be"),
        ("[cornell_box]", "[]", r"scenes: is \[\]\. .*at least 1 item"),
        ("[cornell_box]", "cornell_box", r"scenes: is 'cornell_box'\. "),
        ("scenes: [cornell_box]\n", "", r"scenes: is missing\. Add it"),
        ("film:\n  height: 16", "film: 16", r"film: is 16\. .* valid dictionary"),
        ("  height: 16", "  height: 16\n  height: 8", r"is not YAML: .*duplicate key .*height"),
        ("film:", "film", "is not YAML"),
    ],
)
def test_a_bad_key_or_section_is_said_in_words(tmp_path, old, new, words):
    assert old in GOOD
    with pytest.raises(UserError, match=rf"params\.yaml: {words}"):
        read(tmp_path, GOOD.replace(old, new))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("film.height", "3", r"is 3\. .*greater than or equal to 4"),
        ("reference.passes", "3", r"is 3\. Input should be greater than or"),
        ("reference.passes", "-4", r"is -4\. Input should be greater than"),
        ("reference.passes", "many", r"is 'many'\. .* valid integer"),
        ("reference.passes", "4.5", r"is 4\.5\. .* valid integer"),
        ("reference.passes", "", r"is None\. .* valid integer"),
        ("reference.passes", "yes", r"is '?(yes|True)'?\. .* valid integer"),
        ("field.search_radius", "-1", r"is -1\. .* number greater than 0, or auto"),
        ("field.search_radius", "wide", r"is 'wide'\. .* greater than 0, or auto"),
        ("field.initial_scale", ".inf", r"is inf\. .* greater than 0, or auto"),
        ("field.initial_scale", "true", r"is True\. .* 0, or auto"),
        ("field.neighbours", "all", r"is 'all'\. .*'both', 'radius' or 'knn'"),
        ("field.k", "0", r"is 0\. .*greater than or equal to 1"),
        ("field.normal_test", "7", r"is 7\. .*valid boolean"),
        ("field.precision", "half", r"is 'half'\. .*'float32' or 'compact'"),
        ("reference.alpha", "1.0", r"is 1\.0\. .*less than 1"),
        ("train.held_out", "1", r"is 1\. .*less than 1"),
        ("train.final_rate", "0", r"is 0\. .*greater than 0"),
        ("train.loss", "l1", r"is 'l1'\. .*'squared' or 'relative'"),
        ("runtime.variant", "scalar_rgb", r"is 'scalar_rgb'\. .*'llvm_ad_rgb'"),
        ("amortize.views", "1", r"is 1\. .*greater than or equal to 2"),
        ("photons.seed", "-1", r"is -1\. .*greater than or equal to 0"),
        ("render.spp", "0", r"is 0\. .*greater than or equal to 1"),
        ("metrics.relmse_epsilon", "0", r"is 0\. .*greater than 0"),
    ],
)
def test_a_bad_value_is_said_with_its_key(tmp_path, key, value, words):
    section, leaf = key.split(".")
    with pytest.raises(UserError, match=rf"params\.yaml: {re.escape(key)}: {words}"):
        read(tmp_path, f"scenes: [a]\n{section}:\n  {leaf}: {value}\n")


def test_images_are_for_those_who_learn_from_them(tmp_path):
    text = """
scenes: [a, b, c]
methods: {classical: [path_50], learned: [splatting_3, cache, everywhere]}
baselines:
  path_50: {system: path_tracer}
  cache: {system: radiance_cache}
  splatting_3: {system: splatting, views: 3, scenes: [a]}
  everywhere: {system: instant_ngp, views: 2}
  walking: {system: instant_ngp, views: 10}
animation: {scenes: [b], methods: [gpf, walking, path_50]}
"""
    params = read(tmp_path, text)
    assert [count_needed_images(params, scene) for scene in "abc"] == [3, 10, 2]
    alone = read(tmp_path, text.replace(", everywhere]", "]").replace("[b]", "[]"))
    assert [count_needed_images(alone, scene) for scene in "abc"] == [3, 0, 0]


VARIED = """\
scenes: [a, b]
baselines:
  sppm_3: {system: sppm, passes: 3}
ablations:
  scenes: [a]
  run: [k_5]
  variants:
    k_5: {group: k, title: "5", set: {field.k: 5}}
    fast: {group: switches, set: {train.rates.means: 0, field.neighbours: knn}}
animation:
  scenes: [b]
  methods: [gpf, sppm_3]
"""


def test_variants_change_what_they_name_and_nothing_else(tmp_path):
    params = read(tmp_path, VARIED)
    five, fast = params.variant("k_5"), params.variant("fast", {"field.k": 7})
    assert (five.field.k, fast.field.k, params.field.k) == (5, 7, 3)
    assert (fast.train.rates.means, fast.field.neighbours) == (0, "knn")
    assert fast.train.rates.quats == params.train.rates.quats
    assert five == params.vary({"field.k": 5}) != params.vary({})
    assert params.variant("k_5", {"field.k": 7}) == five
    titles = [variant_title(params.ablations.variants[name]) for name in ("k_5", "fast")]
    assert titles == ["5", "train.rates.means: 0, field.neighbours: knn"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("field.k: 5", "field.kk: 5", r"variants\.k_5\.set: field\.kk: is an unknown key\. Did y"),
        ("field.k: 5", "field.k: 0", r"k_5\.set: field\.k: is 0\. Input should be greater than or"),
        ("field.k: 5", "field.k: [5]", r"k_5\.set: field\.k: is \[5\]\. .* valid integer"),
        ("field.k: 5", "field.k.x: 5", r"k_5\.set: field\.k: is \{'x': 5\}\. .* valid integer"),
        ("field.k: 5", "field: 5", r"k_5\.set: a variant cannot set field\. Keys must begin with"),
        ("field.k: 5", "film.height: 5", r"cannot set film\.height\. .*: field\., train\."),
        ("rates.means: 0", "rate.means: 0", r"fast\.set: train\.rate: is an unknown key\. Did you"),
        (
            "title:",
            "titel:",
            r"ablations\.variants\.k_5\.titel: is an unknown key\. Did you",
        ),
        ("group: k,", "", r"ablations\.variants\.k_5\.group: is missing"),
        ("run: [k_5]", "run: [k_6]", r"run: k_6 is not among the variants\. Did you mean 'k"),
        ("run: [k_5]", "run: [k_5, k_5]", r"ablations\.run: lists k_5 more than once"),
        ("scenes: [a]", "scenes: [c]", r"ablations\.scenes: c is not among .*scenes are a, b"),
        ("scenes: [b]", "scenes: [c]", r"animation\.scenes: c is not among the scenes"),
        ("sppm_3]", "sppm_4]", r"animation\.methods: sppm_4 is not a method\. Did you mean 'sppm"),
        ("methods:", "fps: 0\n  methods:", r"animation\.fps: is 0\. .*than or equal to 1"),
        (
            "field.k: 5",
            "field.direct: emitters",
            r"direct is emitters, but reference\.direct is p",
        ),
    ],
)
def test_what_variants_may_not_say(tmp_path, old, new, words):
    assert old in VARIED
    text = VARIED.replace(old, new)
    if "emitters" in new:
        text += "reference: {direct: photons}\n"
    with pytest.raises(UserError, match=words):
        read(tmp_path, text)


def test_missing_params_are_told(tmp_path):
    with pytest.raises(UserError, match=r"params\.yaml: cannot be read\. Run `gpf` in the project"):
        read_params(tmp_path / "params.yaml")


def test_the_projects_own_params_say_everything():
    params = read_params(PROJECT / "params.yaml")
    written = YAML(typ="safe").load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    # With every key there, people need not look for it, and DVC tracks it.
    assert params.model_dump(mode="json").keys() == written.keys()
    for name, section in params.model_dump(mode="json").items():
        if isinstance(section, dict):
            fixed = {"max_depth"} if name == "reference" else set()  # -1 is its only value
            assert section.keys() - fixed == written[name].keys(), name
    assert set(params.scenes) <= {p.parent.name for p in (PROJECT / "scenes").glob("*/scene.xml")}


@pytest.mark.parametrize("text", ["[" * 3000, "- " * 3000, "film: " + "9" * 5000])
def test_files_that_are_too_deep_or_have_endless_numbers_are_told(tmp_path, text):
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(UserError, match=r"params\.yaml: is not YAML: .*Correct that line"):
        read_params(file)
