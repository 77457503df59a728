"""convert obeys the verdict of a result, and that which a URDF states."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from calib.diagnosis.reasons import CARE, NO, Reason, Verdict, Why
from calib.errors import CalibError, FileError, VerdictError
from calib.result.calibration_file import read_result, write_result
from calib.robot.urdf import Urdf
from calib.verbs.convert.camera.options import NOTHING_NAMED, CameraOptions
from calib.verbs.convert.conversion import convert
from calib.verbs.convert.convert import FORMATS, Options
from calib.verbs.convert.text import text
from tests.parts import with_part
from tests.verbs.convert.forms import write_forms

LOST = Reason.of(Why.PARAMETER_FAR, largest=0.2)
ENDINGS = {
    "urdf": ".urdf",
    "ur-yaml": ".yaml",
    "ur-conf": ".conf",
    "origins": ".yaml",
    "pal": ".yaml",
    "dynamixel-hardware": ".yaml",
    "ros2-transmission": ".yaml",
    "lerobot": ".json",
    "lerobot-dynamixel": ".json",
    "camera-mount": ".urdf",
    "static-transform": ".sh",
}
#: Written of results of images alone, which this is not.
OF_IMAGES = {"camera-info", "opencv"}
TRACKER = CameraOptions(new_camera_frame="tracker")


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One robot in every form, and its result with other verdicts."""
    folder = write_forms(tmp_path_factory.mktemp("forms"))
    result = read_result(folder / "result.json")
    for name, use in (("bad", NO), ("care", CARE)):
        write_result(
            with_part(result, "trust", verdict=Verdict(use, (LOST,))), folder / f"{name}.json"
        )
    write_result(with_part(result, "trust", verdict=None), folder / "none.json")
    convert(str(folder / "bad.json"), folder / "bad.urdf", accept=True)
    return folder


@pytest.mark.parametrize("name", sorted(set(FORMATS) - OF_IMAGES))
def test_no_format_is_written_of_what_is_not_to_be_used(shop: Path, tmp_path: Path, name: str):
    path = tmp_path / f"made{ENDINGS.get(name, '.csv')}"
    camera = TRACKER if FORMATS[name].of_camera else NOTHING_NAMED
    options = Options(to=name, hash_from=shop / "calibration.conf", ur_model="UR3", camera=camera)
    with pytest.raises(VerdictError, match="parameter_far"):
        convert(str(shop / "bad.json"), path, options=options)
    assert not path.exists()
    done = convert(str(shop / "bad.json"), path, options=options, accept=True)
    assert done.against.startswith("do not use (parameter_far): ")
    assert path.exists()


def test_a_urdf_states_the_verdict_and_is_else_the_same(shop: Path, tmp_path: Path):
    convert(str(shop / "none.json"), tmp_path / "plain.urdf")
    stated = Urdf.read(shop / "bad.urdf")
    assert "parameter_far" in stated.verdict
    assert stated.with_verdict("").data == (tmp_path / "plain.urdf").read_bytes()


def test_a_urdf_that_states_it_is_refused_like_the_result(shop: Path, tmp_path: Path):
    source, options = str(shop / "bad.urdf"), Options(base="base", tip="tool0")
    for to in ("origins", "urdf"):
        path = tmp_path / f"made{ENDINGS[to]}"
        with pytest.raises(VerdictError, match="parameter_far"):
            convert(source, path, options=replace(options, to=to))
        assert not path.exists()
    nominal = replace(options, robot=str(shop / "robot.urdf"))
    convert(source, tmp_path / "again.urdf", options=nominal, accept=True)
    assert Urdf.read(tmp_path / "again.urdf").verdict == Urdf.read(source).verdict


def test_a_file_on_a_urdf_that_states_an_earlier_verdict_does_not_inherit_it(shop, tmp_path):
    options = Options(robot=str(shop / "bad.urdf"), base="base", tip="tool0")
    convert(str(shop / "origins.yaml"), tmp_path / "made.urdf", options=options)
    assert Urdf.read(tmp_path / "made.urdf").verdict == ""


@pytest.mark.parametrize(
    ("source", "said"),
    [("care.json", "use with care"), ("none.json", "none, the result was not validated")],
)
def test_the_verdict_is_printed(shop: Path, tmp_path: Path, source: str, said: str):
    done = convert(str(shop / source), tmp_path / "made.csv", to="dh")
    assert done.against == ""
    assert f"Verdict on {source}: {said}" in " ".join(text(done, source).split())


def test_a_calibration_and_a_robot_are_written_as_their_files_are(shop: Path, tmp_path: Path):
    result = read_result(shop / "care.json")
    expected = convert(shop / "care.json", tmp_path / "expected.csv", to="hayati").path.read_bytes()
    made = convert(result, tmp_path / "made.csv", to="hayati")
    assert made.path.read_bytes() == expected
    assert made.source.kind == "result"
    of_robot = convert(result.robot, tmp_path / "robot.csv", to="hayati", robot=result.nominal)
    assert of_robot.path.read_bytes() == expected
    assert (
        convert(result.robot, tmp_path / "robot.urdf").path.read_bytes() == result.robot.urdf.data
    )
    with pytest.raises(FileError, match=r"made\.csv"):
        convert(result, tmp_path / "made.csv", to="hayati")
    convert(result, tmp_path / "made.csv", to="hayati", overwrite=True)


def test_a_calibration_that_is_not_to_be_used_is_refused(shop: Path, tmp_path: Path):
    result = read_result(shop / "bad.json")
    with pytest.raises(VerdictError, match="parameter_far"):
        convert(result, tmp_path / "made.csv", to="dh")
    assert convert(result, tmp_path / "made.csv", to="dh", accept=True).against


def test_a_file_to_update_is_refused_where_the_format_is_written_anew(shop: Path, tmp_path: Path):
    options = Options(update=shop / "result.json")
    for name in ("zeros", "dh", "urdf"):
        with pytest.raises(CalibError, match="--update"):
            convert(
                shop / "care.json",
                tmp_path / f"new{ENDINGS.get(name, '.csv')}",
                to=name,
                options=options,
            )
