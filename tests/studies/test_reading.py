"""Files of studies: what they say, and one sentence for each mistake, before anything has run."""

from pathlib import Path

import pytest

from maesn import GradientMetaLearner, cli
from maesn.rules import SearchRule
from maesn.runs.config import RunSettings
from maesn.search import SearchSettings
from maesn.serialization import fields_to_json, leaves
from maesn.storage import RunError
from maesn.studies.members import members_of_run
from maesn.studies.plan import make_plan
from maesn.studies.reading import read_study, shipped_studies
from maesn.studies.spec import StudySpec

WHOLE = """
family = "point"
seeds = [3, 4]

[runs.plain]
preset = "maesn"
iterations = 7
adaptation.context.learned = false
[runs.plain.on.point]
episodes_per_task = 9

[scratch.trpo]
max_kl = 0.02

[evaluations.search]
rule = "search exploration=1"
episodes = 10
[evaluations.usual]
num_tasks = 5
[evaluations.usual.on.point]
num_tasks = 6
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_a_file_becomes_the_settings_that_commands_use(tmp_path: Path) -> None:
    study = read_study(written(tmp_path, WHOLE))
    assert (study.name, study.families, study.seeds) == ("mine", ("point",), (3, 4))
    first, second = members_of_run(study, "plain", "point")
    assert [first.seed, second.seed] == [3, 4]
    assert isinstance(first.run.settings, RunSettings)
    assert (first.run.settings.iterations, first.run.settings.episodes_per_task) == (7, 9)
    assert isinstance(first.run.learner, GradientMetaLearner)
    assert not first.run.learner.adaptation.context.learned
    search = study.evaluations["search"].usual
    assert search.rule == SearchRule(SearchSettings(exploration=1.0))
    assert search.budget == (10, 1, 5)
    assert study.evaluations["usual"].on["point"].num_tasks == 6
    assert study.scratch["trpo"].max_kl == 0.02


def test_every_setting_of_a_run_can_be_said(tmp_path: Path) -> None:
    study = read_study(written(tmp_path, 'family = "wheeled"\n[runs.maesn]'))
    (member,) = members_of_run(study, "maesn", "wheeled")
    of_run = [
        name
        for name in fields_to_json(member.run.settings)
        if name not in ("method", "family", "variant", "seed", "num_threads")
    ]
    for name, value in leaves(fields_to_json(member.run.learner)).items():
        if not name.endswith("type") and value is not None:
            of_run.append(name)
    said = leaves(fields_to_json(member.run.settings)) | leaves(fields_to_json(member.run.learner))
    lines = [
        f"{name} = {str(said[name]).lower() if isinstance(said[name], bool) else repr(said[name])}"
        for name in of_run
        if said[name] is not None
    ]
    text = 'family = "wheeled"\n[runs.maesn]\n' + "\n".join(lines)
    (again,) = members_of_run(read_study(written(tmp_path, text)), "maesn", "wheeled")
    assert again.needs == member.needs  # the same digest


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("family = ", "is not TOML"),
        ("seeds = [0]", "a study needs families"),
        ('family = "whelled"\n[runs.maesn]', "`families`: `family` must be"),
        ('family = "point"', "nothing is compared"),
        ('family = "point"\nseed = [0]\n[runs.maesn]', "no key `seed`. Did you mean `seeds`?"),
        (
            'family = "point"\nseeds = ["a"]\n[runs.maesn]',
            "`seeds`: `seeds[0]` must be of type int",
        ),
        ('family = "point"\nthreads = 0\n[runs.maesn]', "`threads` must be at least 1, got 0"),
        ('family = "point"\n[runs.mason]', "`runs.mason.preset`: there is no method `mason`"),
        (
            'family = "point"\n[runs.maesn]\niteration = 3',
            "`runs.maesn`: there is no setting `iteration`. Did you mean `iterations`?",
        ),
        (
            'family = "point"\n[runs.maesn]\nouter.trust_region.max_kl = "a"',
            "`runs.maesn`: `TrustRegion.max_kl` must be of type float",
        ),
        (
            'family = "point"\n[runs.maesn]\niterations = -1',
            "`runs.maesn`: `iterations` must be at least 0",
        ),
        (
            'family = "point"\n[runs.maesn]\n[evaluations.a]\nepisode = 5',
            "`evaluations.a`: there is no key `episode`. Did you mean `episodes`?",
        ),
        (
            'family = "point"\n[runs.maesn]\n[evaluations.a]\nepisodes = 7',
            "`evaluations.a`: `episodes` must be a multiple of `episodes_per_update`",
        ),
        (
            'family = "point"\n[runs.maesn]\n[evaluations.a]\nrule = "serch"',
            "`evaluations.a.rule`: `rule` must be one of gradient, search",
        ),
        (
            'family = "point"\n[runs.maml]\n[evaluations.a]\nrule = "search"',
            "`lines.1`: `maml` cannot be adapted like this",
        ),
        (
            'family = "point"\n[scratch.tpro]',
            "`scratch.tpro.method`: there is no method from scratch",
        ),
        (
            'family = "point"\n[runs.maesn]\n[[lines]]\nrun = "maml"',
            "`lines.1.run`: there is no name `maml`.",
        ),
        (
            'family = "point"\n[runs.maesn]\n[[lines]]\nevaluation = "usual"',
            "`lines.1`: a line needs `run` or `scratch`",
        ),
        (
            'family = "point"\n[runs.maesn]\n[[figures]]\nkind = "pie"',
            "`figures.1.kind`: `kind` must be 'curves' or 'dots' or",
        ),
        (
            'family = "point"\n[runs.maesn]\n[[figures]]\nlines = ["maesn-serch"]',
            "`figures.1.lines`: there is no name `maesn-serch`.",
        ),
        (
            'family = "point"\n[runs.maesn]\n[runs.maesn-b]\npreset = "maesn"\n[evaluations.a]\n'
            '[evaluations.b]\n[[lines]]\nrun = "maesn"\n[[lines]]\nrun = "maesn-b"\n'
            'evaluation = "a"',
            "`lines`: two lines have the name `maesn-b`: rename a run.",
        ),
        (
            'family = "point"\n[runs.maesn.on.ant]\niterations = 3',
            "`runs.maesn.on`: there is no name `ant`.",
        ),
        ('family = "point"\nseeds = []\n[runs.maesn]', "a study needs seeds"),
        (
            'family = "point"\nseeds = [1, 1]\n[runs.maesn]',
            "`runs.maesn`: each seed takes part once, got seeds 1, 1.",
        ),
        (
            'family = "point"\n[scratch.trpo]\nseeds = [1, 1]',
            "`scratch.trpo`: each seed takes part once, got seeds 1, 1.",
        ),
        (
            'family = "point"\n[runs.zero_action]\npreset = "maesn"',
            "`lines`: `zero_action` is the name of a reference: rename what is called so.",
        ),
        (
            'family = "point"\n[runs.maesn]\ntasks = "test"\n[evaluations.a]\ntasks = "training"',
            "`lines.1`: `maesn` was trained on tasks of its own",
        ),
        (
            'family = "point"\noracle = "taught"\n[runs.maesn]\n[runs.taught]\n'
            'preset = "oracle"\ntasks = "test"\n[evaluations.a]\ntasks = "training"',
            "`oracle`: `taught` was trained on tasks of its own",
        ),
        (
            'family = "point"\n[runs.maesn]\n[evaluations.a]\ndeploy_after = [0, 100]',
            "`evaluations.a`: `deploy_after` needs `deploy_episodes`",
        ),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, sentence: str
) -> None:
    path = written(tmp_path, text)
    assert cli.run(["study", "run", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"maesn study: `{path}`")
    assert sentence in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_there_is_no_such_study(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="there is no study `papre`: give a"):
        read_study("papre")


LARGE = ("ablation", "field", "paper")


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=[pytest.mark.long] * (x in LARGE)) for x in sorted(shipped_studies())],
)
def test_shipped_studies_can_be_planned(name: str) -> None:
    study = read_study(name)
    assert isinstance(study, StudySpec)
    jobs, comparisons = make_plan(study)
    assert jobs
    assert {one.world["family"] for one in comparisons} == set(study.families)
    done: set[str] = set()
    for job in jobs.values():
        assert set(job.needs) <= done  # each behind those that it needs
        done.add(job.name)


def test_a_line_says_whether_its_tasks_were_trained_on(tmp_path: Path) -> None:
    text = 'families = ["grid_navi", "point"]\n[runs.maesn]\n'
    few, many = make_plan(read_study(written(tmp_path, text)))[1]
    assert few.lines["lines"][0].document([])["evaluation"]["trained_on"]
    assert "trained_on" not in many.lines["lines"][0].document([])["evaluation"]


def test_a_family_may_be_one_of_its_variants(tmp_path: Path) -> None:
    text = """
        families = ["sparse_point:varibad", "sparse_point:metacure"]
        [runs.maesn]
        on."sparse_point:varibad".iterations = 7
        [evaluations.its]
        on."sparse_point:varibad".num_tasks = 3
    """
    jobs, comparisons = make_plan(read_study(written(tmp_path, text)))
    assert [one.name for one in comparisons] == ["sparse_point-varibad", "sparse_point-metacure"]
    assert [one.world["horizon"] for one in comparisons] == [100, 32]
    lines = [line for one in comparisons for line in one.lines["lines"]]
    assert [line.num_tasks for line in lines] == [3, 100]
    assert sorted(job.iterations for job in jobs.values() if job.iterations) == [7, 300]
    for line in lines:  # settings that suit the family hold on each variant
        assert line.first.settings["learner.context.kl_weight"] == 1e-3
    wrong = written(tmp_path, 'family = "sparse_point:pear"\nruns.maesn = {}')
    with pytest.raises(RunError, match=r"`families`: `variant` must be .* got 'pear'"):
        make_plan(read_study(wrong))
