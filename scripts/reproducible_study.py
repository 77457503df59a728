"""What a result depends on besides its inputs: threads, processes, order of rows and columns, kernels of BLAS.

    python scripts/reproducible_study.py [--only CASE ...] [--seed SEED] [--workers N]

Each case is calibrated once as usual, and once under each change, by the program in a process of its own. Printed is
for each pair `equal` if all values of both result files are the same to the last bit (but for the time, and names and
hashes of inputs), and the corrected URDF is but for the run's id, which has the table's hash in it. Otherwise the
largest change of a parameter, in its standard deviations, and the share of the values that differ; `!` marks another
verdict or another model. A kernel that the processor cannot run is marked `-`.

Where the rows stand in another order, without a column `order`, only what is not listed by rows is compared.
"""

from __future__ import annotations

import csv
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from studies import print_table, run_jobs, study_parser

from calib.basics.json_files import read_json
from calib.example import franka_file
from calib.result.calibration_file import EXPECTED, SCHEMA, read_result
from calib.verbs.calibrate.again import Again, compare_tables

ROOT = Path(__file__).resolve().parents[1]

#: A table that is written by `simulate`, by the words after it.
SIMULATED = "table.csv"

#: Outputs of a calibration.
RESULT, URDF = "result.json", "corrected.urdf"

#: The id of the run in a corrected URDF.
RUN = re.compile(rb"<!-- calib run: \w+ -->")

#: Keys of what is listed by the rows, or stands in their order: they are in another order if rows are.
BY_ROWS = ("rows.", "cross_validation.residual", "cross_validation.poses", "outside", "outliers", "suspects",
           "nominal_cross_validation.residual", "nominal_cross_validation.poses", "model.candidates", "outputs",
           "run", "non_geometric.residual", "non_geometric.cross_validation.residual",
           "non_geometric.cross_validation.poses")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Words of a calibration, after those that make its table."""

    words: str
    simulate: str = ""
    cell: str = ""


UR3 = "ur3 table.csv --base base --tip tool0"

CASES = {
    "paper, auto": Case("robot.urdf paper.csv --base base --tip tool0"),
    "paper, dh": Case("robot.urdf paper.csv --base base --tip tool0 --model dh"),
    "poses": Case(f"{UR3} --model dh", "ur3 --base base --tip tool0 --kind pose --count 80"),
    "sockets": Case(
        'robot.urdf fixed.csv --kind fixed --base base --tip tool0 --target "50 50 50 mm" --cell cell.toml',
        cell="sockets.toml",
    ),
    "pixels": Case(
        "panda corners.csv --base panda_link8 --tip panda_link0 --camera camera.toml --board board.toml --model dh"
    ),
    "compliance": Case(
        'ur5 table.csv --base base_link --tip tool0 --model dh+compliance --payload "5 kg"',
        'ur5 --base base_link --tip tool0 --model dh+compliance --payload "5 kg" --sizes "compliance 3e-5 rad/Nm" '
        "--count 60",
    ),
    "stations": Case(
        f"{UR3} --frame estimate --model dh",
        "ur3 --base base --tip tool0 --frame estimate --cell cell.toml --count 20",
        "visits.toml",
    ),
    "bootstrap": Case(
        "robot.urdf paper.csv --base base --tip tool0 --model dh --no-validate --bootstrap 100 --seed 1"
    ),
}


@dataclass(frozen=True)
class Variation:
    """Something that is changed: the environment, the words, or the table."""

    environment: Mapping[str, str] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    #: Changes of the rows of the table, one after the other
    table: tuple[Callable[[list[list[str]], random.Random], None], ...] = ()


def with_order(rows: list[list[str]], _: random.Random) -> None:
    """Add the column ``order``."""
    rows[0].append("order")
    for number, row in enumerate(rows[1:], start=1):
        row.append(str(number))


def shuffled(rows: list[list[str]], rng: random.Random) -> None:
    """Shuffle the rows below the header."""
    below = rows[1:]
    rng.shuffle(below)
    rows[1:] = below


def columns_shuffled(rows: list[list[str]], rng: random.Random) -> None:
    """Shuffle the columns."""
    order = list(range(len(rows[0])))
    rng.shuffle(order)
    rows[:] = [[row[column] for column in order] for row in rows]


def kernel(name: str) -> Variation:
    """Return the variation with another kernel of OpenBLAS."""
    return Variation({"OPENBLAS_CORETYPE": name})


#: What should change nothing, all at once.
SURROUNDINGS = {
    "OPENBLAS_NUM_THREADS": "4",
    "OMP_NUM_THREADS": "4",
    "PYTHONHASHSEED": "12345",
    "LC_ALL": "C",
    "TZ": "Asia/Tokyo",
}

VARIATIONS = {
    "4 threads, another hash seed, locale, time zone, folder": Variation(SURROUNDINGS),
    "2 processes": Variation(words=("--workers", "2")),
    "columns shuffled": Variation(table=(columns_shuffled,)),
    "column `order`, rows shuffled": Variation(table=(with_order, shuffled)),
    "rows shuffled": Variation(table=(shuffled,)),
    "NumPy without AVX2": Variation({"NPY_DISABLE_CPU_FEATURES": "X86_V3 AVX2 FMA3"}),
    "kernel Zen": kernel("Zen"),
    "kernel SkylakeX": kernel("SkylakeX"),
    "kernel Sandybridge": kernel("Sandybridge"),
    "kernel Nehalem": kernel("Nehalem"),
}


def prepare(case: Case, folder: Path, seed: int) -> str:
    """Write the inputs of a case into a folder, and return the name of its table."""
    shutil.copy(ROOT / "urdf" / "ur3.urdf", folder / "robot.urdf")
    shutil.copy(ROOT / "calib" / "example" / "ur3_leica.csv", folder / "paper.csv")
    shutil.copy(ROOT / "scripts" / "goldens_data" / "fixed.csv", folder)
    for name in ("corners.csv", "camera.toml", "board.toml"):
        shutil.copy(franka_file(name), folder)
    if case.cell:
        shutil.copy(ROOT / "scripts" / "goldens_data" / case.cell, folder / "cell.toml")
    if case.simulate:
        words = [*shlex.split(case.simulate), "--seed", str(seed), "-o", SIMULATED]
        program("simulate", words, folder, {})
    return next(word for word in case.words.split() if word.endswith(".csv"))


def run(case: Case, folder: Path, variation: Variation | None = None) -> bool:
    """Calibrate a case in a folder; return False if the processor cannot."""
    variation = variation or Variation()
    words = [*shlex.split(case.words), "--json", RESULT, "-o", URDF, "--accept", "--quiet"]
    return program("calibrate", [*words, *variation.words], folder, variation.environment)


def program(verb: str, words: Sequence[str], folder: Path, environment: Mapping[str, str]) -> bool:
    """Run the program in a folder; return False if it met an instruction that the processor does not have."""
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    usual = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": paths}
    done = subprocess.run(
        [sys.executable, "-m", "calib", verb, *words],
        cwd=folder,
        env=os.environ | usual | dict(environment),
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if done.returncode > 0:
        raise RuntimeError(f"calib {verb} {shlex.join(words)}: {done.stderr}")
    return done.returncode == 0


def vary_table(path: Path, change: Callable[[list[list[str]], random.Random], None]) -> None:
    """Change the rows of a table in place."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.reader(file))
    change(rows, random.Random(1))
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)


def case_texts(name: str, variations: Sequence[str], seed: int) -> list[str]:
    """Calibrate a case as usual and under each change, and say what differs."""
    case = CASES[name]
    texts = []
    with tempfile.TemporaryDirectory() as root:
        inputs, usual = Path(root, "inputs"), Path(root, "usual")
        inputs.mkdir()
        table = prepare(case, inputs, seed)
        shutil.copytree(inputs, usual)
        run(case, usual)
        for number, variation in enumerate(VARIATIONS[name] for name in variations):
            folder = Path(root, f"other {number}", "deeper")
            shutil.copytree(inputs, folder)
            if variation.words and "--bootstrap" not in case.words:
                texts.append("")
                continue
            for change in variation.table:
                vary_table(folder / table, change)
            done = run(case, folder, variation)
            same_order = variation.table != (shuffled,)
            texts.append(compared(usual, folder, by_rows=same_order) if done else "-")
    return texts


def compared(usual: Path, other: Path, *, by_rows: bool) -> str:
    """Say what differs between the results of two folders."""
    paths = (usual / RESULT, other / RESULT)
    tables = [read_json(path, "result", SCHEMA, EXPECTED) for path in paths]
    before, result = (read_result(path) for path in paths)
    count, differences = compare_tables(*tables)
    skipped = ("run", "outputs.urdf.sha256", *(() if by_rows else BY_ROWS))
    kept = tuple(each for each in differences if not each.path.startswith(skipped))
    urdfs = [RUN.sub(b"", (folder / URDF).read_bytes()) for folder in (usual, other)]
    if not kept and urdfs[0] == urdfs[1]:
        return "equal"
    pair = Again(before=before, result=result, changes=(), compared=count, differences=kept)
    farthest = max((moved.in_std for moved in pair.moved), default=0.0)
    traits = []
    for each in (before, result):
        larger = each.non_geometric
        traits.append(
            (
                sorted(each.model.names),
                None if larger is None else sorted(larger.model.names),
                None if each.verdict is None else each.verdict.use,
            )
        )
    return f"{farthest:.0e} ({len(kept) / count:.0%}){'' if traits[0] == traits[1] else ' !'}"


def main() -> None:
    """Print a row for each case, a column for each change."""
    parser = study_parser(__doc__, parallel=True)
    parser.add_argument("--only", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--vary", nargs="*", default=list(VARIATIONS), choices=list(VARIATIONS))
    parser.add_argument("--seed", type=int, default=1, help="of the simulated tables")
    arguments = parser.parse_args()
    jobs = [(name, arguments.vary, arguments.seed) for name in arguments.only]
    texts = run_jobs(case_texts, jobs, workers=arguments.workers, label="cases")
    rows = ([name, *row] for name, row in zip(arguments.only, texts, strict=True))
    print_table(["case", *arguments.vary], rows)


if __name__ == "__main__":
    main()
