"""The data that come with calib: the paper's UR3, as a table and as a URDF.

Source: Huangfu, Hang, Cheng, Yu, Li, Yang, Shen, "Kinematic Calibration for Robot Based on LM Algorithm",
Light Industry Machinery 35(4), 2017, DOI 10.3969/j.issn.1005-2895.2017.04.001, Tables 1 and 2.
"""

from __future__ import annotations

from pathlib import Path

#: The reflector in ``tool0`` that Table 2 fits [m]: the printed (69.97, -70.20, 22.52) mm turned by
#: 180 deg about z. See docs/paper.md.
PAPER_TARGET = (-0.06997, 0.07020, 0.02252)

#: The reflector in ``tool0`` as the paper prints it [m].
PAPER_TARGET_AS_PRINTED = (0.06997, -0.07020, 0.02252)


def paper_measurements() -> Path:
    """Return the path of the paper's Table 2: 35 rows, joint angles [deg] and tracker points [mm] in ``base``."""
    return Path(__file__).with_name("ur3_leica.csv")


def paper_urdf() -> Path:
    """Return the path of the nominal UR3 of the paper's Table 1, links ``base`` to ``tool0``."""
    installed = Path(__file__).with_name("ur3.urdf")
    if installed.is_file():
        return installed
    # In a checkout the only copy of the file is in urdf/, where people look for it.
    return Path(__file__).resolve().parents[2] / "urdf" / "ur3.urdf"


def franka_file(name: str) -> Path:
    """Return the path of a file of the Franka arm with a camera: 24 pictures of a printed board, of others.

    Args:
        name: ``"corners.csv"``, a table of corners, board ``a`` and the same board at another place, ``b``;
            ``"camera.toml"``; or ``"board.toml"``. ``"LICENSE.txt"`` has source and licence (MIT).
    """
    return Path(__file__).with_name("franka") / name


def dh_rows(robot: str) -> Path:
    """Return the path of an example of DH rows, from the maker's public data: ``"kuka_kr6_r900"``.

    Args:
        robot: Name of a file in ``calib/example/rows``, without its ending.
    """
    return Path(__file__).with_name("rows") / f"{robot}.csv"
