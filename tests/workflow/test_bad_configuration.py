"""Invalid configurations: one message for each, and no job is started."""

import re

import pytest

pytestmark = pytest.mark.slow

VALID = "instrument: {wavelength_nm: [500]}\n"
# By kind of error: the experiment file, and two texts that the message must contain.
INVALID = {
    "misspelt key": ("medium: {saturaton: 0.1}", "medium.saturaton", "did you mean saturation?"),
    "density above that of ice": ("medium: {density_kg_m3: 950}", "density_kg_m3 = 950", "916.9"),
    "largest grain below smallest": (
        "medium: {grain_size_um: [750, 300]}",
        "grain_size_um = [750, 300]",
        "min <= max",
    ),
    "negative depth": ("medium: {depth_m: -0.1}", "depth_m = -0.1", "(0, 10000] m"),
    "wavelength too short": (
        "instrument: {wavelength_nm: [100]}",
        "wavelength_nm = 100.0",
        "[200, 100000] nm",
    ),
    "mean outside its range": (
        "medium: {facetness: [0.2, 0.4, 0.5, 0.072]}",
        "facetness = [0.2, 0.4, 0.5, 0.072]",
        "min <= mean <= max",
    ),
    "too much water": ("medium: {saturation: 1.2}", "saturation = 1.2", "[0, 1]"),
    "empty grid": (
        "grid: {saturation: []}",
        "grid.saturation = []",
        "at least one value",
    ),
    "name with a slash": ("name: a/b", "name = 'a/b'", "letters, digits and underscores"),
    "not YAML": ("title: [1, 2\nmedium: {}", "line 2", "not YAML"),
}


@pytest.fixture(scope="module")
def rejected_run(make_project, tmp_path_factory):
    """Return a run with all invalid files and a valid one, and the project."""
    project = make_project(tmp_path_factory.mktemp("rejected"))
    project.put("good", VALID)
    for case, (text, *_) in INVALID.items():
        project.put(get_file_stem(case), f"{text}\n")
    return project.snakemake("--cores", 1), project


def get_file_stem(case):
    return case.replace(" ", "_")


def check_rejection(run, file, key, allowed):
    """Assert that exactly one line reports a file, with its path, the key and a hint."""
    lines = [line for line in run.text.splitlines() if f"{file}.yaml" in line]
    assert len(lines) == 1, run.text
    assert lines[0].startswith(f"config/experiments/{file}.yaml")
    assert key in lines[0]
    assert allowed in lines[0]


def check_nothing_ran(run, project):
    assert run.code != 0
    assert "Traceback" not in run.text
    assert run.jobs() == []
    assert not (project.folder / "results").exists()


@pytest.mark.parametrize("case", INVALID)
def test_invalid_experiments_are_rejected_before_any_job(rejected_run, case):
    run, project = rejected_run
    check_rejection(run, get_file_stem(case), *INVALID[case][1:])
    check_nothing_ran(run, project)


def test_all_invalid_experiments_are_reported_at_once(project):
    """Also those that the target does not need."""
    project.put("good", VALID)
    project.put("one", "titel: x\n")
    project.put("two", "instrument: {wavelength_nm: 50}\n")
    run = project.snakemake("--cores", 1, "good")
    lines = [line for line in run.text.splitlines() if line.startswith("config/experiments")]
    assert len(lines) == 2, run.text
    assert lines[0].startswith("config/experiments/one.yaml, line 1: titel: unknown key")
    assert lines[1].startswith(
        "config/experiments/two.yaml, line 1: instrument.wavelength_nm = 50.0: must"
    )
    check_nothing_ran(run, project)


def test_misspelt_setting_on_the_command_line_is_rejected(project):
    project.put("good", VALID)
    run = project.snakemake("--cores", 1, config="accuracy=drafd")
    lines = [line for line in run.text.splitlines() if line.startswith("config/config.yaml")]
    assert len(lines) == 1, run.text
    assert "accuracy = 'drafd'" in lines[0]
    assert "did you mean draft?" in lines[0]
    check_nothing_ran(run, project)


def test_selection_beside_the_target_everything_is_rejected(project):
    project.put("good", VALID)
    run = project.snakemake("everything", "--dry-run", config="accuracy=tiny experiments=good")
    assert "experiments: must be left out with the target everything" in run.text
    check_nothing_ran(run, project)


def test_wrong_value_of_a_study_names_file_and_line(project):
    project.put("good", VALID)
    function = "workflow.papers.splitsnow.make_table1"
    study = f"seed: 2\nstudies:\n  mine:\n    function: {function}\n    inputs: {{a: good}}\n"
    (project.folder / "mine.yaml").write_text(study, encoding="utf-8")
    run = project.snakemake("--dry-run", "--configfile", "mine.yaml")
    (line,) = [line for line in run.text.splitlines() if "mine.yaml" in line]
    assert "mine.yaml, line 5: studies.mine.inputs.a: unknown key, must be one of sample" in line
    check_nothing_ran(run, project)


def test_missing_names_of_studies_are_reported(project):
    project.put("good", VALID)
    function = "workflow.papers.splitsnow.make_table1"
    study = f"studies:\n  mine:\n    function: {function}\n    inputs: {{sample: goood}}\n"
    (project.folder / "mine.yaml").write_text(study, encoding="utf-8")
    run = project.snakemake("--dry-run", "--configfile", "mine.yaml")
    assert "study mine is left out: no such experiment: goood (did you mean good?)" in run.text


def test_errors_of_jobs_name_the_file_and_the_line(project):
    """What an instrument or a figure rejects has the place where it is written, also in the log."""
    project.put("beach", "medium: {kind: sand}\ninstrument: {wavelength_nm: [2500]}\n")
    project.put(
        "bare",
        """\
name: bare_map
instrument: {kind: goniophotometer, wavelength_nm: [500], polar_deg: [0, 30], rays: 1000}

figure: {kind: hemisphere}
""",
    )
    run = project.snakemake("beach", "bare_map", "--cores", 1, "--keep-going")
    assert run.code and "Traceback" not in run.text
    beach = (
        r"config/experiments/beach\.yaml, line 2: instrument\.wavelength_nm = 2500\.0: must be in "
        r"\[198, 2053\.1\] nm"
    )
    for expected in (
        beach,
        r"config/experiments/bare\.yaml, line 4: figure\.kind = 'hemisphere': .* at least 3 polar",
    ):
        assert re.search(f"^{expected}", run.text, re.MULTILINE), run.text
    (log,) = project.folder.glob("results/**/logs/simulate/beach.log")
    assert re.match(beach, log.read_text("utf-8"))
