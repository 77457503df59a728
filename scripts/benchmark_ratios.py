"""Quick parts of calib, in multiples of a reference loop in the same run, so that a slow machine makes none slower.

    python scripts/benchmark_ratios.py               the ratios now, beside those of docs/performance.md
    python scripts/benchmark_ratios.py --slower 1.25 the same with every part made slower by a quarter

The reference does what calib does: products of small matrices, sums over blocks of samples, and plain Python between
them. Processor time counts, not that of the clock, and the best of several runs, part and reference in turn and as long
as each other: what else runs on the machine disturbs both.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from benchmark_one import fit_input, one_pass, simulate
from benchmark_page import cells_of
from studies import print_table, study_parser

from calib.boards.board import Board, corner_signs
from calib.boards.corners.saddles import find_saddles
from calib.fit.estimate.fitting import fit
from calib.result.calibrate import calibrate

#: A part is slower than the page says if its ratio exceeds that of the page this many times.
LIMIT = 1.2

#: Runs of a part and the reference, and how often as many are added while a part seems to be slower, or if there is
#: nothing to compare it with.
ROUNDS, MORE = 7, 4

Work = Callable[[], object]


def reference() -> float:
    """Run the loop that times are compared with: some milliseconds; return a sum that depends on all of it."""
    rng = np.random.default_rng(0)
    blocks = rng.normal(size=(6, 3, 3, 1024))
    columns = rng.normal(size=(3 * 256, 27))
    total = 0.0
    for k in range(6):
        T = np.eye(3)
        for _ in range(12):
            T = T @ blocks[k, :, :, 0] / 3.0
            total += float(np.sum(np.linalg.solve(T + 9.0 * np.eye(3), T[:, 0])))
        product = np.einsum("ijn,jkn->ikn", blocks[k], blocks[(k + 1) % 6])
        total += float(np.sum(product * np.sin(blocks[k])))
        normal = columns.T @ columns
        total += float(np.linalg.eigvalsh(normal)[0])
        names = {f"joint_{i}": i for i in range(400)}
        total += sum(names[name] for name in sorted(names, key=str.casefold))
    return total


def corners() -> Work:
    """Return the refinement of 63 corners in a picture of a chessboard that is drawn here."""
    board = Board(pattern="chessboard", columns=10, rows=8, square=0.02)
    v, u = np.indices((400, 480)) - 20.5
    # Squares of 44 px, blurred by a pixel or so.
    columns, rows = (np.tanh(10.0 * np.sin(np.pi * along / 44.0)) for along in (u, v))
    image = 120.0 - 80.0 * columns * rows
    image += np.random.default_rng(0).normal(0.0, 3.0, image.shape)
    x, y = np.meshgrid(np.arange(1, 10), np.arange(1, 8))
    expected = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64) * 44.0 + 21.2
    windows = np.tile(6.0 * np.eye(2), (len(expected), 1, 1))
    signs = corner_signs(board)
    assert find_saddles(image, expected, windows, signs).exist.all()
    return partial(find_saddles, image, expected, windows, signs)


def fit_of(rows: int) -> Work:
    """Return a fit of so many rows, given the model."""
    return partial(fit, *fit_input(rows))


def calibration_of(rows: int) -> Work:
    """Return `calibrate` of so many rows, with choice of the model, cross-validation and verdict."""
    return partial(calibrate, *simulate(rows))


def help_page() -> Work:
    """Return a process that prints the help of `calib`."""
    command = [sys.executable, "-m", "calib", "--help"]
    return partial(subprocess.run, command, stdout=subprocess.DEVNULL, check=True)


#: The parts, by their name on the page.
PARTS: Mapping[str, Callable[[], Work]] = {
    "fit of 30 rows": partial(fit_of, 30),
    "fit of 3,000 rows": partial(fit_of, 3_000),
    "one pass of 30,000 rows": partial(one_pass, 30_000),
    "`calibrate` of 30 rows, `auto`, cross-validated": partial(calibration_of, 30),
    "63 corners of a picture": corners,
    "`calib --help`, the process": help_page,
}


def processor_time() -> float:
    """Return the processor time of this process and of those that it has started and that ended [s]."""
    times = [time.process_time()]
    if sys.platform != "win32":
        import resource

        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        times += [children.ru_utime, children.ru_stime]
    return sum(times)


def seconds_of(work: Work) -> float:
    """Return the processor time of a call [s]."""
    began = processor_time()
    work()
    return processor_time() - began


@dataclass
class Ratio:
    """The best times of a part and of the reference beside it."""

    #: The part
    work: Work
    #: Calls of the reference that take as long as the part
    calls: int
    #: Best time of the part, and of one call of the reference [s]
    part: float = np.inf
    alone: float = np.inf

    @classmethod
    def of(cls, work: Work) -> Ratio:
        """Return the part before it is measured; it runs once, and the reference too."""
        work()
        reference()
        return cls(work, max(1, round(seconds_of(work) / seconds_of(reference))))

    def measure(self) -> None:
        """Run the reference and the part `ROUNDS` times in turn."""
        for _ in range(ROUNDS):
            began = processor_time()
            for _ in range(self.calls):
                reference()
            self.alone = min(self.alone, (processor_time() - began) / self.calls)
            self.part = min(self.part, seconds_of(self.work))

    @property
    def value(self) -> float:
        """The part's time in those of the reference."""
        return self.part / self.alone


def measured_ratios(stated: Mapping[str, float], slower: float = 1.0) -> dict[str, float]:
    """Measure the ratio of each part.

    Args:
        stated: Ratios of the page by part: one that exceeds its limit is measured again, because the best of more runs
            is less disturbed.
        slower: Factor by which each part is made slower, to try whether that is noticed.

    Returns:
        The ratios by part.
    """
    result = {}
    for name, make in PARTS.items():
        work = make()
        ratio = Ratio.of(partial(_slowed, work, slower) if slower > 1.0 else work)
        ratio.measure()
        for _ in range(MORE):
            if ratio.value <= LIMIT * stated.get(name, 0.0):
                break
            ratio.measure()
        result[name] = ratio.value
    return result


def stated_ratios() -> dict[str, float]:
    """Return the ratios of the page by part."""
    return {name: float(number) for name, number in cells_of("ratios")}


def _slowed(work: Work, factor: float) -> None:
    """Do some work, and then nothing for as long as makes it take a factor of its processor time."""
    began = processor_time()
    work()
    until = began + factor * (processor_time() - began)
    while processor_time() < until:
        pass


def main() -> None:
    """Print the ratios now beside those of the page; with status 1 if a part is slower."""
    parser = study_parser(__doc__)
    parser.add_argument("--slower", type=float, default=1.0, help="make every part slower")
    arguments = parser.parse_args()
    stated = stated_ratios()
    now = measured_ratios(stated, arguments.slower)
    rows = [
        [
            name,
            f"{value:.2f}",
            f"{stated.get(name, np.nan):.2f}",
            f"{value / stated.get(name, np.nan):.2f}",
        ]
        for name, value in now.items()
    ]
    print_table(["part", "now", "page", "now over page"], rows, [50])
    sys.exit(any(value > LIMIT * stated.get(name, np.inf) for name, value in now.items()))


if __name__ == "__main__":
    main()
