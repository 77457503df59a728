"""The 27 sets of non-linear regression of NIST's Statistical Reference Datasets.

https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml. Observations, starts and certified values are those of NIST's
files, digit by digit (works of the United States government, in the public domain). The models are NIST's equations.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np

from calib.basics.arrays import Array
from calib.numerics.solvers import System

_FOLDER = Path(__file__).with_name("nist")


@dataclass(frozen=True)
class NistSet:
    """A set: its observations, two starts, and what NIST certifies."""

    name: str
    level: str
    #: As NIST wrote them
    y_text: tuple[str, ...]
    #: Shape (n,); of Nelson the logarithm, which its model predicts
    y: Array
    #: Shape (n,), or (2, n) for Nelson
    x: Array
    #: Shape (2, p)
    starts: Array
    #: Shape (p,), 11 digits
    certified: Array
    #: Shape (p,), standard deviations of the parameters
    standard_deviations: Array
    sum_of_squares: float
    residual_standard_deviation: float

    def system(self) -> System:
        """Return the function of b, (p,), to the residual y - f(x, b) and its derivative, exact to rounding."""
        model, x, y = MODELS[self.name], self.x, self.y

        def system(b: Array) -> tuple[Array, Array]:
            # A starting value may lead to an overflow, which is a trial that fails, not an error.
            with np.errstate(all="ignore"):
                columns = []
                for k in range(len(b)):
                    moved = b.astype(complex)
                    moved[k] += 1e-200j * max(abs(b[k]), 1e-30)
                    columns.append(model(x, moved).imag / moved[k].imag)
                return y - model(x, b), -np.stack(columns, axis=1)

        return system

    def residual(self, b: Array) -> Array:
        """Return the residual at b, (p,), shape (n,).

        That of Lanczos1 is 1e-13 of values near 1, and has three digits in double precision, one of y - f(x, b): so its
        differences are of numbers of 40 digits.
        """
        if self.name != "Lanczos1":
            return self.system()(b)[0]
        with localcontext() as context:
            context.prec = 40
            terms = [(Decimal(float(b[k])), Decimal(float(b[k + 1]))) for k in (0, 2, 4)]
            residual = []
            for x, y in zip(self.x, self.y_text, strict=True):
                model = sum(
                    (factor * (-rate * Decimal(repr(float(x)))).exp() for factor, rate in terms),
                    Decimal(),
                )
                residual.append(float(Decimal(y) - model))
        return np.array(residual)

    def standard_errors(self, b: Array) -> Array:
        """Return the standard deviations of the parameters at the solution b, (p,): those of s^2 (J^T J)^-1."""
        _, J = self.system()(b)
        Q, R = np.linalg.qr(J)
        r = self.residual(b)
        # What a step still to come would take away, by the last digits of b, is no part of the scatter.
        r = r - Q @ (Q.T @ r)
        variance = float(r @ r) / (len(r) - len(b))
        return np.sqrt(variance * np.sum(np.linalg.inv(R) ** 2, axis=1))


def digits(found: Array, certified: Array) -> float:
    """Return to how many digits all numbers found agree with those certified; at most 11, which NIST gives."""
    worst = float(np.max(np.abs(found / certified - 1.0)))
    return min(11.0, -np.log10(max(worst, 1e-16))) if np.isfinite(worst) else -np.inf


def _rows(name: str) -> list[dict[str, str]]:
    """Return the rows of a table of the folder."""
    with (_FOLDER / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def read_sets() -> dict[str, NistSet]:
    """Return the sets by name."""
    parameters, observations = _rows("parameters"), _rows("observations")
    sets = {}
    for row in _rows("sets"):
        name = row["set"]
        of_set = [one for one in parameters if one["set"] == name]
        observed = [one for one in observations if one["set"] == name]
        y = np.array([float(one["y"]) for one in observed])
        x = np.array([float(one["x1"]) for one in observed])
        if name == "Nelson":
            y = np.log(y)
            x = np.stack([x, np.array([float(one["x2"]) for one in observed])])
        assert len(y) == int(row["observations"])
        sets[name] = NistSet(
            name=name,
            level=row["level"],
            y_text=tuple(one["y"] for one in observed),
            y=y,
            x=x,
            starts=np.array([[float(one[f"start {k}"]) for one in of_set] for k in (1, 2)]),
            certified=np.array([float(one["certified"]) for one in of_set]),
            standard_deviations=np.array([float(one["standard deviation"]) for one in of_set]),
            sum_of_squares=float(row["sum of squares"]),
            residual_standard_deviation=float(row["residual standard deviation"]),
        )
    return sets


def _chwirut(x: Array, b: Array) -> Array:
    return np.exp(-b[0] * x) / (b[1] + b[2] * x)


def _enso(x: Array, b: Array) -> Array:
    def cycle(period: complex, cosine: complex, sine: complex) -> Array:
        angle = 2.0 * np.pi * x / period
        return cosine * np.cos(angle) + sine * np.sin(angle)

    return b[0] + cycle(12.0, b[1], b[2]) + cycle(b[3], b[4], b[5]) + cycle(b[6], b[7], b[8])


def _gauss(x: Array, b: Array) -> Array:
    peaks = b[2] * np.exp(-(((x - b[3]) / b[4]) ** 2)) + b[5] * np.exp(-(((x - b[6]) / b[7]) ** 2))
    return b[0] * np.exp(-b[1] * x) + peaks


def _cubic(x: Array, b: Array) -> Array:
    above = b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3
    return above / (1.0 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def _lanczos(x: Array, b: Array) -> Array:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _rat43(x: Array, b: Array) -> Array:
    return b[0] / (1.0 + np.exp(b[1] - b[2] * x)) ** (1.0 / b[3])


def _mgh09(x: Array, b: Array) -> Array:
    return b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3])


#: The model of each set: (x, b) -> y, analytic in b.
MODELS: dict[str, Callable[[Array, Array], Array]] = {
    "Bennett5": lambda x, b: b[0] * (b[1] + x) ** (-1.0 / b[2]),
    "BoxBOD": lambda x, b: b[0] * (1.0 - np.exp(-b[1] * x)),
    "Chwirut1": _chwirut,
    "Chwirut2": _chwirut,
    "DanWood": lambda x, b: b[0] * x ** b[1],
    "ENSO": _enso,
    "Eckerle4": lambda x, b: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "Gauss3": _gauss,
    "Hahn1": _cubic,
    "Kirby2": lambda x, b: (b[0] + b[1] * x + b[2] * x**2) / (1.0 + b[3] * x + b[4] * x**2),
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Lanczos3": _lanczos,
    "MGH09": _mgh09,
    "MGH10": lambda x, b: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda x, b: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": lambda x, b: b[0] * (1.0 - np.exp(-b[1] * x)),
    "Misra1b": lambda x, b: b[0] * (1.0 - (1.0 + b[1] * x / 2.0) ** -2),
    "Misra1c": lambda x, b: b[0] * (1.0 - (1.0 + 2.0 * b[1] * x) ** -0.5),
    "Misra1d": lambda x, b: b[0] * b[1] * x / (1.0 + b[1] * x),
    "Nelson": lambda x, b: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    "Rat42": lambda x, b: b[0] / (1.0 + np.exp(b[1] - b[2] * x)),
    "Rat43": _rat43,
    "Roszman1": lambda x, b: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": _cubic,
}
