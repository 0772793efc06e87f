"""Rate of one position in horizontal axes, given each hypothesis about slow tilts and accelerometer drift.

A horizontal vector is complex: forward + i left.  y, rad/s, is the horizontal rate by the gyros, less what
the tilt makes of the vertical one, and α, rad, the angle by the accelerometers: tilt about forward + i that
about left.  t begins with the record.  Equations have the numbers of docs/appendix/alignment-method.md::

    gyros            y = c + b + Σ A_k ds_k/dt + noise,              s_k = 1 - exp(-t/τ_k)      (4)
    accelerometers   α = Σ A_k s_k + Σ B_j w_j + walk + noise,       w_j = 1 - exp(-t/T_j)      (5)

Both are linear in x = (c + b, A, B): the constant rate of earth and bias, and the amplitudes of the unit's
tilt and of the accelerometers' warm-up.  c + b has a flat prior.  A hypothesis is a prior of the amplitudes:
the unit stands, or tilts; the accelerometers have warmed up, or warm up.

`fit_position` first subtracts a sway, the strongest spectral line.  The regression is of the means in cells,
Hann windows that overlap by half: an angle that stays bounded falls out of them, as their sum is flat with
smooth ends.  Their scatter about a slow trend is the noise, and a cell far beyond that is a knock.
"""

import math

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY

from .parameters import ANY_WARM_UP, KnownWarmUp
from .position import Position, PositionFit, upright

CELLS = (96, 24, 6)  # candidate numbers of cells in a record; ablation: 48 alone makes 2.4 times the error
MIN_CELLS = 5  # fewer used cells give no scatter about a trend
OVERLAP = 1.0 / 6.0
"""Correlation of white noise in neighbouring Hann cells: the mean of their product over that of a square."""
TREND_ORDER = 5
"""Coefficients of the polynomial trend about which cells scatter; at most a quarter of the used cells."""
KNOCK = 10.0
"""Residual, in medians of the residuals, above which a cell is rejected; row "knocks" of the ablation."""
MIN_VARIANCE = 1e-18
"""Lower bound of the variance of a cell, (rad/s)² or rad², for readings that do not change at all."""
CREEP_CELLS, CREEP_ANGLE, CREEP_NOISE = 12, 3e-4, 4.0
"""A unit creeps about the vertical whose angle by means of 12 cells of the vertical gyro, less their mean,
varies by more than 0.3 mrad and more than 4 times what the white noise turns meanwhile: it has no fit."""
MIN_PERIODS, LEFT_SHARE = 1.5, 0.3
"""A line of the sway has so many periods in the record at least (a slower sway is left to the trend and the
tilt), and leaves this share of the variance at most: noise and knocks have power at all frequencies."""
TILT_TAU_S = np.geomspace(5.0, 640.0, 8)
"""Time constants of a unit that tilts, as a tripod that settles, in octaves; assumed."""
TILT_SD, P_TILTS = (1e-5, 1e-4, 1e-3), 0.3
"""Standard deviation of the amplitudes of a unit that tilts, rad, and the prior probability that it does.
With 0.03 a slow tilt passes for a bias, 9 sigma off."""
TILTS = np.vstack([sd * sum(np.eye(6, 8, k) for k in range(3)) for sd in TILT_SD])
"""Standard deviation of each amplitude, rad, (18, 8), three neighbours alike.  Ablation: "settling"."""
WALK = 1e-7  # random walk of a warmed-up accelerometer, g/√s; assumed


def fit_position(record: Position, latitude: float, known: KnownWarmUp | None) -> PositionFit | None:
    """Return the fit of a position; None if its record is too short, or if the unit creeps.

    The latitude is in rad; a known warm-up of the accelerometers is subtracted.
    """
    # y and α in horizontal axes, of which the mean force is the vertical.
    valid, means = record.rows()
    if not (divisions := [cells for count in CELLS if (cells := _cells(valid, count))]):
        return None
    force = means[:, 3:] / STANDARD_GRAVITY
    attitude = upright(record.attitude[0], force[valid].mean(axis=0))
    if known is not None:
        time_s = record.begun_s + record.row_s * (np.arange(len(valid)) + 0.5)
        force -= known.bias_g(np.asarray(time_s, np.float64))
    gyro, force = means[:, :3] @ attitude.T, force @ attitude.T
    alpha = np.where(valid, force[:, 1] - 1j * force[:, 0], 0.0)
    y = gyro[:, 0] + 1j * gyro[:, 1] - 1j * alpha * EARTH_RATE * math.sin(latitude)
    n, row_s = len(valid), record.row_s
    warm_sd, warm_tau_s = ANY_WARM_UP if known is None else known.remaining
    y_design, alpha_design = _designs(n, row_s, np.array(warm_tau_s))
    slow = np.hstack([_trend(n, TREND_ORDER), y_design[:, 1 : 1 + len(TILT_TAU_S)]])
    without_line, line = _without_sway(np.column_stack([y, alpha]), valid, slow)
    if _creeps(gyro[:, 2], valid, row_s):
        return None
    # and both in cells, without the sway.
    windows, used, variance = _divide(without_line[:, 0], divisions)
    count, cell_s = len(used), row_s * n / (len(used) + 1.0)
    correlation = np.eye(count) + OVERLAP * (np.eye(count, k=1) + np.eye(count, k=-1))
    y_cells, alpha_cells = (windows @ without_line).T
    # Λ and η of x by (4) in the cells, where the amplitudes of the line are uncertain,
    y_mean, line_cells = y_cells[used].mean(), windows[used] @ line
    noise = variance * correlation[np.ix_(used, used)] + line_cells @ line_cells.T
    information = _information(windows[used] @ y_design, y_cells[used] - y_mean, noise)
    # and by (5) in steps from cell to cell: in none is the constant part of α, nor a cell with a knock.
    alpha_variance, alpha_used, _ = _scatter(alpha_cells, used, TREND_ORDER)
    steps = np.diff(np.eye(count), axis=0)[alpha_used[1:] & alpha_used[:-1]]
    noise = alpha_variance * steps @ correlation @ steps.T + WALK**2 * cell_s * np.eye(len(steps))
    information += _information(steps @ windows @ alpha_design, steps @ alpha_cells, noise)
    # Amplitudes are integrated over their prior: mean of c + b and variance of each of its parts are left.
    sd, prior = _hypotheses(warm_sd, len(warm_tau_s))
    precision, of_rate, log_weight = eliminate(information[:, :-2], information[:, -2:], sd)
    rate_variance = 1.0 / precision[:, 0, 0]
    rate = of_rate[:, 0, :] * rate_variance[:, None]
    log_weight += 0.5 * np.sum(rate**2, axis=1) / rate_variance + np.log(rate_variance) + np.log(prior)
    up_cells = windows @ gyro[:, 2]
    up_variance, up_used, _ = _scatter(up_cells, used, 1)
    return PositionFit(
        log_weight=log_weight,
        rate=rate @ np.array([1.0, 1j]) + y_mean,
        variance=rate_variance,
        vertical=float(up_cells[up_used].mean()),
        vertical_variance=(1.0 + 2.0 * OVERLAP) * up_variance / up_used.sum(),
        white=min(variance, up_variance) * row_s / np.sum(windows[0] ** 2),
        attitude=attitude,
        azimuth_error=record.azimuth_error,
        gyro_mean=complex(y[valid].mean()),
        hann_mean=complex(np.hanning(valid.sum()) @ y[valid]),
    )


def _creeps(vertical: FloatArray, valid: BoolArray, row_s: float) -> bool:
    """Return whether the vertical gyro, rad/s, (n,), seems to turn slowly, at a changing rate."""
    cells = _cells(valid, CREEP_CELLS)
    if cells is None:
        return False
    windows, used = cells
    means = windows[used] @ vertical
    angle = np.cumsum(means - means.mean()) * row_s * len(valid) / (CREEP_CELLS + 1)
    steps = np.diff(vertical[valid])
    steps = steps[steps != 0.0]  # a sample may fill several rows
    white_angle = math.sqrt(0.5 * steps @ steps) * row_s * len(valid) / max(len(steps), 1)
    return float(np.ptp(angle)) > max(CREEP_ANGLE, CREEP_NOISE * white_angle)


def _without_sway(data: ColumnArray, valid: BoolArray, slow: FloatArray) -> tuple[ColumnArray, FloatArray]:
    """Return y, rad/s, and α, rad, (n, 2), without the strongest line of y.

    The line is fitted beside slow functions of time, (n, m).  Cosine and sine have an amplitude that may
    change along the record, and the frequency by a fraction of a period in the record.  The second result
    are these functions times the amplitude, (n, 4), rad/s: its uncertainty; zero where there is no line.
    """
    sway = (data[:, 0] - slow @ _amplitudes(slow, data[:, 0], valid)) * valid
    n = len(sway)
    bins = 1 << (8 * n - 1).bit_length()  # at least eight to a period in the record
    least = math.ceil(MIN_PERIODS * bins / n)
    axes = np.column_stack([sway.real, sway.imag]) * np.hanning(n + 2)[1:-1, None]
    power = np.sum(np.abs(np.fft.rfft(axes, bins, axis=0)) ** 2, axis=1)[least : bins // 2]
    periods = (least + int(np.argmax(power))) * (n - 1) / bins
    time = np.linspace(-1.0, 1.0, n)[:, None]
    phase = np.pi * periods * time
    line = np.hstack([np.cos(phase), np.sin(phase), time * np.cos(phase), time * np.sin(phase)])
    columns = np.hstack([slow, line])
    amplitudes = _amplitudes(columns, data, valid)
    remains = (data - columns @ amplitudes)[valid, 0]
    if np.vdot(remains, remains).real > LEFT_SHARE * np.vdot(sway, sway).real:
        return data, np.zeros_like(line)
    swing = line @ amplitudes[-4:]
    return data - swing, line * math.sqrt(2.0 * np.mean(np.abs(swing[:, 0]) ** 2))


def _amplitudes(columns: FloatArray, data: ColumnArray, valid: BoolArray) -> ColumnArray:
    """Return the least-squares solution over the valid rows."""
    columns = columns[valid]
    normal = columns.T @ columns
    # The slow columns are almost dependent: a weak prior keeps them from following a sway.
    normal.flat[:: len(normal) + 1] *= 1.0 + 1e-9
    return np.linalg.solve(normal, columns.T @ data[valid])


def _divide(y: ColumnArray, cells: list[tuple[FloatArray, BoolArray]]) -> tuple[FloatArray, BoolArray, float]:
    """Return the division into cells of which the mean has the smallest variance.

    It is the weights of the rows in each cell, (J, n), which cells have all rows and no knock, (J,), and the
    variance of each part of a cell.  Longer cells suppress more sway, but have fewer degrees of freedom ν:
    they must be better by the standard deviation √(2/ν) of their variance.
    """
    best, *longer = [(each[0], *_scatter(each[0] @ y, each[1], TREND_ORDER)) for each in cells]
    for other in longer:
        (_, variance, used, freedom), (_, smallest, most, _) = other, best
        if variance / used.sum() * (1.0 + math.sqrt(2.0 / freedom)) < smallest / most.sum():
            best = other
    return best[0], best[2], best[1]


def _cells(valid: BoolArray, count: int) -> tuple[FloatArray, BoolArray] | None:
    """Return Hann windows of sum one, (count, n), and which have all rows; None if too few have."""
    n = len(valid)
    row = (np.arange(n) + 0.5) * ((count + 1) / n)
    from_middle = np.minimum(np.abs(row - np.arange(1, count + 1)[:, None]), 1.0)
    windows = 1.0 + np.cos(np.pi * from_middle)
    used = windows @ ~valid == 0.0
    if n < 2 * (count + 1) or used.sum() < MIN_CELLS:
        return None
    return windows / windows.sum(axis=1, keepdims=True), used


def _scatter(values: ColumnArray, used: BoolArray, order: int) -> tuple[float, BoolArray, float]:
    """Return the variance of cells (of each part) about a trend, those without knocks, and its freedom."""
    basis, square = _trend(len(values), max(1, min(order, int(used.sum()) // 4))), np.zeros(len(values))
    for _ in range(3):  # a knock hides smaller ones
        square = np.abs(values - basis @ np.linalg.lstsq(basis[used], values[used], rcond=None)[0]) ** 2
        used = used & (square <= KNOCK**2 * np.median(square[used]) + MIN_VARIANCE)
    freedom = (2.0 if np.iscomplexobj(values) else 1.0) * max(int(used.sum()) - basis.shape[1], 0.5)
    # The mean of a scaled inverse chi squared.
    return max(float(square[used].sum()) / max(freedom - 2.0, 1.0), MIN_VARIANCE), used, freedom


def _trend(n: int, order: int) -> FloatArray:
    """Return the first Chebyshev polynomials over n points, (n, order)."""
    return np.asarray(np.polynomial.chebyshev.chebvander((np.arange(n) + 0.5) / n * 2.0 - 1.0, order - 1))


def _designs(n: int, row_s: float, warm_tau_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the design matrices of (4) and (5): y = D x, α = D x in each row, (n, k)."""
    ends = -np.expm1(-row_s * np.arange(n + 1.0)[:, None] / np.concatenate([TILT_TAU_S, warm_tau_s]))
    rate = np.diff(ends, axis=0) / row_s
    rate[:, len(TILT_TAU_S) :] = 0.0  # a warm-up does not turn the unit
    return np.insert(rate, 0, 1.0, axis=1), np.insert(0.5 * (ends[1:] + ends[:-1]), 0, 0.0, axis=1)


def _information(design: FloatArray, data: ColumnArray, covariance: FloatArray) -> FloatArray:
    """Return Λ and η, (k, k + 2), of complex data (m,) = design (m, k) x + noise in each part."""
    weighted = np.linalg.solve(covariance, design).T
    return np.asarray(weighted @ np.column_stack([design, data.real, data.imag]))


def _hypotheses(warm_sd: float, warm_ups: int) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of A and B in each hypothesis, (38, k), and its probability, (38,).

    The unit stands, or tilts, with accelerometers that have warmed up, and that warm up, half of each.
    """
    prior = np.r_[1.0 - P_TILTS, np.full(len(TILTS), P_TILTS / len(TILTS))]
    tilt = np.vstack([np.zeros(len(TILT_TAU_S)), TILTS])
    warm = np.outer(np.repeat([0.0, warm_sd], len(tilt)), np.ones(warm_ups))
    return np.hstack([np.tile(tilt, (2, 1)), warm]), np.tile(prior, 2)


def eliminate(
    matrix: FloatArray, vector: FloatArray, sd: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrate a Gaussian over its last m unknowns, which have the prior N(0, sd²), `sd` (..., m).

    Its log density is η'x - ½ x'Λx, with the `matrix` Λ (..., n, n), and the `vector` η (..., n, k) of k sets
    of unknowns with the same Λ, such as the real parts of complex ones.  Returns Λ and η of the other
    unknowns, and the log density of what does not depend on them, (...).
    """
    kept = matrix.shape[-1] - sd.shape[-1]
    last = vector[..., kept:, :]
    # With S = diag(sd) the covariance (Λ + S⁻²)⁻¹ is S (1 + S Λ S)⁻¹ S.
    scale = sd[..., :, None] * sd[..., None, :]
    ratio = np.eye(sd.shape[-1]) + scale * matrix[..., kept:, kept:]
    covariance = scale * np.linalg.inv(ratio)
    gain = matrix[..., :kept, kept:] @ covariance
    log_density = 0.5 * np.sum(last * (covariance @ last), axis=(-2, -1))
    log_density -= 0.5 * vector.shape[-1] * np.linalg.slogdet(ratio)[1]
    remaining = matrix[..., :kept, :kept] - gain @ matrix[..., kept:, :kept]
    return remaining, vector[..., :kept, :] - gain @ last, log_density
