"""How much later the stamps of measured points are than those of joint values, from the motion that both saw.

A first guess is the shift at which the speeds of joints and of points are correlated best. It is refined by least
squares. In each move the points are a smooth function of the joint values,

    p(t) = f(q(t - lag)),

and the lag is where they fit it best. With a robot, f has the forward kinematics p_tip(q), R_tip(q) of the nominal
robot, with an unknown frame and target,

    p = s + R_f p_tip(q) + R_f R_tip(q) t,

linear in 13 unknowns a coordinate. Without one, f is the Taylor polynomial of each move by itself: in the principal
directions z of its joint values, with all terms z^a / a! above `_SMALLEST_TERM`. If the arm does not rest, f is one
sum of products of sines and cosines of up to three joints, for all of the motion. The lag is the zero of sum v.r,
found by Newton's method with its slope g by differences,

    d_lag = - sum v.r / sum g,

with the residual r, and the velocity v of the fitted f along the motion, both without what the unknowns of f explain
(G. Golub, V. Pereyra, 1973). The sums are over moves w. Their scatter gives the standard deviation, whatever errors
there are within each move, of jitter, noise, or a wrong robot:

    sigma^2 = W / (W - 1) sum_w ((v.r + d_lag g)_w / (1 - h_w))^2 / (sum g)^2,

with the part h_w of a shift of one move alone that unknowns in common explain. Of Taylor polynomials
half of what the smaller half of their terms change is added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.robot.robot import Robot
from calib.verbs.bag.speeds import runs, velocities
from calib.verbs.bag.streams import JointStream, PointStream

#: Lags are looked for up to so much either way [s].
_LARGEST = 10.0

#: Speeds are compared on a grid of so much [s].
_GRID = 0.02

#: Speeds are means over so much [s].
_SMOOTH = 0.2

#: Points of a moving arm are taken in windows of so much [s] if it does not rest.
_WINDOW = 1.5

#: A longer move is cut into windows [s].
_LONGEST_MOVE = 4.0

#: So much of the rest before and after a move belongs to its window [s].
_REST = 0.3

#: A term of a Taylor polynomial, of angles [rad], is kept if it may be larger than this.
_SMALLEST_TERM = 1e-3

#: The highest degree of a term.
_HIGHEST_DEGREE = 8

#: So many windows are enough.
_MOST_WINDOWS = 120

#: So many points of a window are enough.
_MOST_POINTS = 400

#: So many points of all windows are enough where they have unknowns in common.
_MOST_TOGETHER = 4000

#: Fewer windows than this say nothing of a standard deviation.
_FEWEST_WINDOWS = 3

#: Speeds slower than this share of the fast ones are rest.
_RESTING = 0.02

#: Velocities are by differences over so much either way [s]: jitter of stamps hardly matters in them.
_STEP = 0.05


@dataclass(frozen=True, slots=True)
class Lag(Value):
    """The time by which points are stamped later than joint values."""

    #: [s]; positive: points come later.
    value: float
    #: Its standard deviation [s].
    sigma: float
    #: Number of moves, or windows, that it is from.
    moves: int
    #: Whether forward kinematics of a robot were used.
    by_robot: bool


@dataclass(frozen=True, slots=True)
class NoLag(Value):
    """Why there is no lag."""

    #: ``no_motion``: joints or points do not move while both are there; ``unclear``: another shift fits as well.
    code: str


def find_lag(joints: JointStream, points: PointStream, robot: Robot | None = None) -> Lag | NoLag:
    """Estimate the lag of points behind joint values.

    Args:
        joints: The joint values; with a robot, their names are the robot's, in its order.
        points: The points.
        robot: The nominal robot; its tip may be any link that the target is fixed to; None: by the motion alone.

    Returns:
        The lag with its standard deviation, or why there is none.
    """
    _, rests = _windows(joints, points, 0.0)
    guesses = (
        _shifts_of_speeds(joints, points)
        if robot is None and rests
        else _shifts_of_paths(joints, points, robot)
    )
    if not guesses:
        return NoLag("no_motion")
    refined = [_refined(joints, points, robot, guess) for guess in guesses]
    found = [each for each in refined if each is not None]
    if not found:
        return NoLag("no_motion")
    found.sort(key=lambda pair: pair[1])
    best, cost = found[0]
    for other, other_cost in found[1:]:
        if abs(other.value - best.value) > _SMOOTH and other_cost < _AS_GOOD * cost:
            return NoLag("unclear")
    return best


#: Another lag with squares less than this times those of the best fits as well.
_AS_GOOD = 1.5


def _shifts_of_speeds(joints: JointStream, points: PointStream) -> list[float]:
    """Return up to three lags at which the speeds of joints and points agree best, the best first [s]."""
    begin = min(joints.times[0], points.times[0]) - _LARGEST
    end = max(joints.times[-1], points.times[-1]) + _LARGEST
    count = int((end - begin) / _GRID) + 1
    grid = begin + _GRID * np.arange(count)
    of_joints, seen_joints = _speed(joints.times, joints.q, grid)
    of_points, seen_points = _speed(points.times, points.positions, grid)
    if not seen_joints.any() or not seen_points.any():
        return []
    shapes = []
    for speed, seen in ((of_joints, seen_joints), (of_points, seen_points)):
        root = np.sqrt(speed)
        root[seen] -= root[seen].mean()
        root[~seen] = 0.0
        if root.std() == 0.0:
            return []
        shapes.append(root)
    size = 2 * count
    product = np.fft.irfft(
        np.conj(np.fft.rfft(shapes[0], size)) * np.fft.rfft(shapes[1], size), size
    )
    most = round(_LARGEST / _GRID)
    shifts = np.arange(-most, most + 1)
    values = product[shifts]
    # Overlaps differ little: a bag is far longer than the largest lag, or it does not matter.
    norm = np.sqrt(np.sum(shapes[0] ** 2) * np.sum(shapes[1] ** 2))
    values = values / norm
    peaks = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
    peaks = peaks[np.argsort(values[peaks])[::-1]]
    chosen: list[int] = []
    for peak in peaks:
        if values[peak] < max(_LEAST_CORRELATION, 0.5 * values[peaks[0]]):
            break
        if all(abs(shifts[peak] - shifts[other]) * _GRID > 2.0 * _SMOOTH for other in chosen):
            chosen.append(int(peak))
        if len(chosen) == 3:
            break
    return [float(shifts[peak]) * _GRID for peak in chosen]


#: Speeds with less correlation are not of one motion.
_LEAST_CORRELATION = 0.2


def _shifts_of_paths(joints: JointStream, points: PointStream, robot: Robot | None) -> list[float]:
    """Return up to three lags at which the points are a function of the joint values, the best first [s]."""
    every = len(points.times) // _POINTS_OF_SCAN + 1
    times, positions = points.times[::every], points.positions[::every]
    if len(times) < _FEWEST_POINTS:
        return []
    if robot is not None:
        terms = _kinematic_terms(robot)
    else:
        terms = _arm_terms(joints.at(times), min(_TERMS_OF_SCAN, len(times) // 8))
    most = round(_LARGEST / _SCAN)
    lags = _SCAN * np.arange(-most, most + 1)
    cost = np.full(len(lags), np.inf)
    for k, lag in enumerate(lags):
        inside = (times - lag >= joints.times[0]) & (times - lag <= joints.times[-1])
        count = int(inside.sum())
        if count < max(len(times) // 2, _FEWEST_POINTS):
            continue
        A = terms(joints.at(times[inside] - lag))
        toward = _toward_basis(A)
        U, p = A @ toward, positions[inside]
        freedom = max(count - toward.shape[1], 1)
        cost[k] = np.sum((p - U @ (U.T @ p)) ** 2) / (3 * freedom)
    lowest = np.flatnonzero((cost[1:-1] <= cost[:-2]) & (cost[1:-1] < cost[2:])) + 1
    variance = float(np.mean((positions - positions.mean(axis=0)) ** 2))
    if not len(lowest) or cost[lowest].min() > _EXPLAINED * variance:
        return []
    lowest = lowest[cost[lowest] < _WORTH_REFINING * cost[lowest].min()]
    return [float(lags[k]) for k in lowest[np.argsort(cost[lowest])][:3]]


#: Lags whose squares are less than this times the least ones may be the best when they are refined.
_WORTH_REFINING = 4.0

#: Lags are tried at this distance [s].
_SCAN = 0.1

#: So many points are enough for it.
_POINTS_OF_SCAN = 1500

#: So many terms of an unknown arm: products of two joints.
_TERMS_OF_SCAN = 150

#: A function of the joint values leaves less than this share of the points' variance, or they are not of one motion.
_EXPLAINED = 0.5


def _speed(times: Array, values: Array, grid: Array) -> tuple[Array, Mask]:
    """Return the speed of values (N, D) on a grid, smoothed, and where on the grid there are values."""
    half = 0.5 * _SMOOTH
    inside = (grid >= times[0] + half) & (grid <= times[-1] - half)
    index = np.searchsorted(times, grid)
    near = np.clip(index, 1, len(times) - 1)
    gap = times[near] - times[near - 1]
    usual = np.median(np.diff(times))
    inside &= gap < max(10.0 * usual, _SMOOTH)
    speed = np.zeros(len(grid))
    speed[inside] = np.linalg.norm(velocities(times, values, grid[inside], half), axis=1)
    return speed, inside


def _windows(joints: JointStream, points: PointStream, lag: float) -> tuple[list[Integers], bool]:
    """Return indices of the points in each move, or in each window of a motion that rarely rests; and if it rests."""
    begin, end = joints.times[0] + _SMOOTH, joints.times[-1] - _SMOOTH
    grid = np.arange(begin, end, _GRID)
    speed, seen = _speed(joints.times, joints.q, grid)
    if not seen.any():
        return [], False
    is_moving = speed > _RESTING * np.quantile(speed[seen], 0.95)
    spans: list[tuple[float, float]] = []
    moves = 0
    for first, last in runs(is_moving):
        start, stop = grid[first] - _REST, grid[last] + _REST
        length = stop - start
        parts = 1 if length <= _LONGEST_MOVE else int(np.ceil(length / _WINDOW))
        moves += parts == 1
        cuts = np.linspace(start, stop, parts + 1)
        spans += list(pairwise(cuts))
    rests = 2 * moves > len(spans)
    if len(spans) > _MOST_WINDOWS:
        chosen = np.linspace(0, len(spans) - 1, _MOST_WINDOWS).round().astype(int)
        spans = [spans[k] for k in chosen]
    windows = []
    margin = _STEP + _SECANT
    for start, stop in spans:
        inside = (points.times >= max(start, joints.times[0] + margin) + lag) & (
            points.times <= min(stop, joints.times[-1] - margin) + lag
        )
        index = np.flatnonzero(inside)
        if len(index) > _MOST_POINTS:
            index = index[:: len(index) // _MOST_POINTS + 1]
        if len(index) >= _FEWEST_POINTS:
            windows.append(index)
    return windows, rests


#: A window with fewer points is not used.
_FEWEST_POINTS = 12


def _refined(
    joints: JointStream, points: PointStream, robot: Robot | None, guess: float
) -> tuple[Lag, float] | None:
    """Refine a lag; return it with the mean square of the residuals [m²], or None if there is no motion."""
    lag = guess
    for _ in range(_MOST_STEPS):
        windows, rests = _windows(joints, points, lag)
        if len(windows) < _FEWEST_WINDOWS:
            return None
        products = partial(_products, joints, points, robot, windows, rests=rests)
        vr, kept, square = products(lag)
        slopes = _slopes(products, lag)
        slope = float(slopes.sum())
        if slope <= 0.0:
            return None
        step = -float(vr.sum()) / slope
        lag += float(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))
        if abs(step) < _ENOUGH:
            break
    W = len(vr)
    spread = float(np.sum(((vr + step * slopes) / kept) ** 2)) * W / (W - 1)
    variance = spread / slope**2
    if robot is None and rests:
        fewer = partial(products, fewer=True)
        change = float(fewer(lag)[0].sum() / _slopes(fewer, lag).sum())
        variance += (_LEFT_OUT * change) ** 2
    sigma = float(np.sqrt(variance))
    return Lag(lag, sigma, W, robot is not None), square


#: Terms that were left out change a lag by this share of what the smaller half of those that were not change.
_LEFT_OUT = 0.5

#: Steps of Newton's method.
_MOST_STEPS = 8

#: The slope of v.r is by differences over so much either way [s].
_SECANT = 0.02

#: The largest step [s]: the guess is no farther off, and the first steps are too long.
_LARGEST_STEP = 0.1

#: A step that ends the search [s].
_ENOUGH = 1e-5


def _slopes(products: Callable[[float], tuple[Array, Array, float]], lag: float) -> Array:
    """Return the derivatives of v.r of each window by the lag, (W,) [m²/s²]."""
    after, before = (products(lag + side * _SECANT)[0] for side in (1.0, -1.0))
    return np.asarray((after - before) / (2.0 * _SECANT))


def _products(
    joints: JointStream,
    points: PointStream,
    robot: Robot | None,
    windows: Sequence[Integers],
    lag: float,
    *,
    rests: bool,
    fewer: bool = False,
) -> tuple[Array, Array, float]:
    """Return v.r of W windows, (W,) [m²/s], the share 1 - h of its own shift that each shows, and the mean r² [m²].

    Where windows have unknowns in common, these explain the part h of a shift of one window. ``fewer`` takes half
    of the terms of Taylor polynomials.
    """
    if robot is not None or not rests:
        every = sum(len(w) for w in windows) // _MOST_TOGETHER + 1
        windows = [w[::every] for w in windows]
        together = np.concatenate(windows)
        owner = np.repeat(np.arange(len(windows)), [len(w) for w in windows])
        terms = (
            _kinematic_terms(robot)
            if robot is not None
            else _arm_terms(joints.at(points.times[together] - lag), len(together) // 8)
        )
        v, r, U, moved = _residual(joints, points, terms, together, lag)
        every_vr = np.sum(v * r, axis=1)
        vr = np.array([float(every_vr[owner == k].sum()) for k in range(len(windows))])
        explained = []
        for number in range(len(windows)):
            own = owner == number
            part = np.sum((U[own].T @ moved[own]) ** 2) / np.sum(moved[own] ** 2)
            explained.append(min(float(part), _MOST_EXPLAINED))
        freedom = 3 * max(len(together) - U.shape[1], 1)
        return vr, 1.0 - np.array(explained), float(np.sum(r**2)) / freedom
    products, squares, freedom = [], 0.0, 0
    for window in windows:
        q = joints.at(points.times[window] - lag)
        terms = _taylor_terms(q, len(window) // 4, fewer=fewer)
        v, r, U, _ = _residual(joints, points, terms, window, lag)
        products.append(float(np.sum(v * r)))
        squares += float(np.sum(r**2))
        freedom += 3 * max(len(window) - U.shape[1], 1)
    return np.array(products), np.ones(len(products)), squares / freedom


#: The largest part of a window's shift that is taken to be explained by unknowns in common.
_MOST_EXPLAINED = 0.8

#: Squared singular values below this share of the largest are zero.
_RANK_TOLERANCE = 1e-10


def _residual(
    joints: JointStream,
    points: PointStream,
    terms: Callable[[Array], Array],
    window: Integers,
    lag: float,
) -> tuple[Array, Array, Array, Array]:
    """Return v and r of k points, (k, 3) each, an orthonormal basis of f's terms, (k, u), and v with them, (k, 3)."""
    times = points.times[window] - lag
    p = points.positions[window]
    A = terms(joints.at(times))
    # v is by the difference of the terms along the motion.
    rate = (terms(joints.at(times + _STEP)) - terms(joints.at(times - _STEP))) / (2.0 * _STEP)
    toward = _toward_basis(A)
    U = A @ toward
    coefficients = toward @ (U.T @ p)
    r = p - U @ (U.T @ p)
    moved = rate @ coefficients
    v = moved - U @ (U.T @ moved)
    return v, r, U, moved


def _toward_basis(A: Array) -> Array:
    """Return the matrix B, (u, rank), for which A B is an orthonormal basis of the columns of A, (k, u)."""
    squared, V = np.linalg.eigh(A.T @ A)
    kept = squared > _RANK_TOLERANCE * squared[-1]
    return np.asarray(V[:, kept] / np.sqrt(squared[kept]))


def _kinematic_terms(robot: Robot) -> Callable[[Array], Array]:
    """Return the function from joint values to the terms of p: 1, position and rotation of the tip, (k, 13)."""

    def terms(q: Array) -> Array:
        """Return the terms at joint values (k, n)."""
        T = robot.poses(q)
        return np.hstack([np.ones((len(q), 1)), T[:, :3, 3], T[:, :3, :3].reshape(-1, 9)])

    return terms


def _arm_terms(q: Array, most: int) -> Callable[[Array], Array]:
    """Return the function from joint values to the terms of an unknown arm's point, up to products of three joints.

    Each coordinate of it is a sum of products with at most one of sin q_j, cos q_j of each joint.

    Args:
        q: shape (k, n), joint values of the motion.
        most: The largest number of terms; products of more joints are left out first.
    """
    moved = np.flatnonzero(np.ptp(q, axis=0) > _SMALLEST_TERM).tolist()
    mean = q.mean(axis=0)
    factors = [(joint, turn) for joint in moved for turn in (0, 1)]
    chosen: list[tuple[tuple[int, int], ...]] = []
    for degree in (1, 2, 3):
        products = [
            each
            for each in combinations(factors, degree)
            if len({joint for joint, _ in each}) == degree
        ]
        if len(chosen) + len(products) < most:
            chosen += products

    def terms(at: Array) -> Array:
        """Return the terms at joint values (k, n)."""
        turned = at - mean
        waves = np.stack([np.sin(turned), np.cos(turned)])
        columns = [np.ones(len(at))]
        for each in chosen:
            column = np.ones(len(at))
            for joint, turn in each:
                column = column * waves[turn, :, joint]
            columns.append(column)
        return np.column_stack(columns)

    return terms


def _taylor_terms(q: Array, most: int, *, fewer: bool) -> Callable[[Array], Array]:
    """Return the function from joint values to the terms of their Taylor polynomial about those of a window.

    Args:
        q: shape (k, n), joint values of the window.
        most: The largest number of terms.
        fewer: Whether only half of them are taken, the larger ones.
    """
    mean = q.mean(axis=0)
    _, _, directions = np.linalg.svd(q - mean, full_matrices=False)
    size = np.abs((q - mean) @ directions.T).max(axis=0)
    used = size > _SMALLEST_TERM
    directions, size = directions[used], size[used]
    # Each term is one of a degree less times a direction that does not precede its last one.
    sized = []
    ends: list[tuple[tuple[int, ...], float]] = [((), 1.0)]
    for _ in range(_HIGHEST_DEGREE):
        longer = []
        for term, value in ends:
            for k in range(term[-1] if term else 0, len(size)):
                extended = value * float(size[k]) / (term.count(k) + 1)
                if extended > _SMALLEST_TERM:
                    longer.append(((*term, k), extended))
        sized += [(value, np.bincount(term, minlength=len(size))) for term, value in longer]
        ends = longer
    sized.sort(key=lambda pair: -pair[0])
    count = min(max(most - 1, 1), len(sized))
    powers_kept = [powers for _, powers in sized[: (count + 1) // 2 if fewer else count]]

    def terms(at: Array) -> Array:
        """Return the terms at joint values (k, n), each at most about 1."""
        z = (at - mean) @ directions.T / size
        columns = [np.ones(len(at))]
        columns += [np.prod(z**powers, axis=1) for powers in powers_kept]
        return np.column_stack(columns)

    return terms
