"""Options of a conversion: the chain between their links; notes: values by code, with a sentence in mm and mrad."""

from __future__ import annotations

from calib.verbs.convert.format import Note, Options


def test_a_robot_is_loaded_between_the_links_of_the_options():
    robot = Options(base="base", tip="wrist_3_link", held={"elbow_joint": 0.3}).load("ur3")
    assert (robot.base, robot.tip) == ("base", "wrist_3_link")
    assert dict(robot.held) == {"elbow_joint": 0.3}
    assert "elbow_joint" not in robot.joint_names


def test_coupled_readings_are_those_of_the_options_or_of_the_source():
    coupling = {"elbow_joint": {"shoulder_lift_joint": -1.0}}
    options = Options(base="base", tip="tool0", coupling=coupling)
    robot = options.load("ur3")
    assert robot.reading_coupling == coupling
    assert options.load(robot) is robot
    assert Options().load(robot) is robot
    assert Options(tip="wrist_3_link").load(robot).reading_coupling == coupling
    assert Options(coupling={}).load(robot).reading_coupling == {}


def test_a_note_words_lengths_in_mm_and_angles_in_mrad():
    note = Note("moved", "{0} moved by {1:.3g} mm and {2:.2f} mrad.", ("It", 1.5e-3, -1e-9))
    assert note.text == "It moved by 1.5 mm and -0.00 mrad."
    assert Note("moved", "By {0:.1f} mm.", (-0.0,)).text == "By 0.0 mm."
    assert Note("still", "Nothing moved.").text == "Nothing moved."
