"""Clicks in closed form, then reweighted: some tenths of a decibel below the linear program's, and many times as fast.

Theory of operation
-------------------
Rows r are all that a click must keep to: samples of the drive, and the quiet fingers of sampled plants at all
instants, each as a fraction of its limit. The strongest click has the least max |r x| of all weights x for which every
felt finger peaks at 1; it is then scaled until a limit binds. It is found in three steps.

1. *Least energy.* The energy under the quiet fingers, summed over plants, is a quadratic form x Q x. By Parseval's
   theorem it needs no time course: products of transfer functions are summed over the plants line by line, for each
   pair of actuators, and one product with the spectra of the tones follows. On damped lines it is the energy weighted
   by exp(-2 sigma t), which counts the click more than its ringing. With M = Q + lambda R, R the energy of the drive,
   and a the row of a felt finger at one instant, the least energy at a x = 1 is 1 / (a M^-1 a), at
   x = M^-1 a / (a M^-1 a). One Cholesky factor gives it for all instants at once, and the best is taken. Several felt
   fingers share the small matrix A M^-1 A^T of their instants; these and the signs are chosen one finger at a time.
2. *Reweighting.* Rows are made of plants of a first part of the pool: those which that click fits worst among the 95 %
   that are to keep the limit.
   The greatest magnitude is the limit of the p-norm, whose minimum is the same closed form with M the sum of
   |r x|^(p-2) r r^T. So p rises, each time with a Newton step and a search along it, and the instants follow the felt
   fingers' peaks. The least energy remains in M as a small part, for the plants that have no rows.
3. *Trimming.* The other plants of the pool are played. What their 95th percentile misses of the limit changes the
   limit of the rows, and a few steps follow. Last the weights are scaled so that percentile and drive keep to theirs.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dtrtrs

from base.arrays import Array, Complex32, Integers, Single
from base.compiled import njit
from precompute.clicks.click_basis import SAMPLE_RATE_HZ, Tones
from precompute.clicks.click_responses import Responses, combine
from precompute.clicks.evaluation import ManyPlants
from precompute.model.damped_lines import DampedLines

SHARE = 95  # percentage of the plants that keep to the quiet level
# The constants below were chosen on 40 to 100 random placements of one to five fingers on each of three bars
# (docs/theory.md#clicks-in-closed-form). Two thirds of the courses lose up to 0.4 dB of a median felt level, a third
# more gain up to 0.3 and take 1 ms; a step less at the start loses up to 0.4 dB, more instants or steps gain up to 0.2.
_OF_FORM, OF_ROWS = 41, 61  # plants whose energy is summed, and whose rows are taken, the nominal first; others trim
_EARLY, _LATE, _AGAIN = (1, 2), (4, 8, 8, 16, 32), (8, 8, 16, 32, 64)
"""Exponents p - 2 of the weights, one step each: powers of 2, so that a weight takes squarings only.

Early, from every instant that is tried; late, from the best of them; and again after a change of the limit.
"""
_TRIED = 2  # instants of one felt finger that are tried: the greatest maxima
_THINNED, _EVERY = 4, 3  # up to this exponent every third row counts, since a sum over fewer instants is as good
_COURSES, _COURSES_OF_A_FINGER, _MOST_COURSES = 24, 9, 40
"""Plants whose rows are made: for one quiet finger, at least for each of some, and at most for all of many."""
_AT_ONCE = 4  # courses whose rows are made at once: 36 with 66 tones take 0.8 ms so, and 2.5 ms all at once
_ROWS_S = 0.04  # rows are made from the start of the click until this long after its end; later peaks are trimmed alone
_DRIVE, _ENERGY, _RIDGE = 1e-3, 0.1, 1e-3
"""Parts, by trace: of R in the least energy, of that in every later M, and of the unit matrix in the least energy.

They keep M far from singular, whose rows are in single precision: another processor's rounding moves a waveform by
0.1 %. With a hundredth of the energy it was 2 %, another level by up to 0.8 dB, and contrasts lower by up to 0.4 dB.
"""
_NEGLIGIBLE = np.float32(1e-4)  # rows of a lower weight, relative to the greatest, are left out of M
_STEPS = np.array([0, 0.05, 0.1, 0.2, 0.35, 0.6, 1], np.float32)
"""Fractions of a Newton step that are tried; 0: it stays."""
_LEAST_CHANGE, _MOST_CHANGE = 0.7, 2.0  # factors by which trimming changes the rows at once
_FIRST, _AFTER_S = 0.5, 0.025  # felt fingers may peak from this fraction of the click until this long after its end
_LIKELY = 60  # instants of each of several felt fingers that are tried: those with the least energy alone
_TURNS = 3


class ClosedForm:
    """Solves clicks of one device and length; drive (row, tone): rows that are at most 1 within the limits."""

    def __init__(self, tones: Tones, lines: DampedLines, drive: Array) -> None:
        self._tones, self._lines = tones, lines
        self._spectrum = lines.transform(tones.wave)
        self._drive = np.ascontiguousarray(drive, np.float32)
        drive_energy = drive.T @ drive
        self._drive_energy: Array = drive_energy / np.trace(drive_energy)
        self._own = [np.flatnonzero(tones.actuator == actuator) for actuator in np.unique(tones.actuator)]
        weight = np.full(len(lines.s_per_s), 2.0, np.float32)  # a line stands for its conjugate too
        weight[0] = 1.0
        self._line_weight = weight
        length_s = (tones.wave.shape[1] - 1) / SAMPLE_RATE_HZ
        self._first = round(_FIRST * length_s * lines.rate_hz)
        self._last = min(round((length_s + _AFTER_S) * lines.rate_hz), lines.steps)
        self._sparse = _half_as_dense(lines)
        self._row_steps = min(round((length_s + _ROWS_S) * self._sparse.rate_hz), self._sparse.steps)

    def solve(
        self, pool: Responses, felt: Sequence[int], quiet: Sequence[int], limit: float, many: ManyPlants
    ) -> Array:
        """Weights (tone,) of the strongest click within the drive's limits and `limit` under the quiet fingers.

        pool: responses of sampled plants, the nominal one first; limit in units of the detection threshold. many:
        others like those of the pool from OF_ROWS on.
        """
        formed = pool.transfer[:_OF_FORM]
        felt_rows = np.empty((len(felt) * self._last, len(self._spectrum)), np.float32)
        self._fill_rows(formed[:, felt].mean(axis=0), self._lines, 1.0, felt_rows)
        aims = _Aims(felt_rows.reshape(len(felt), self._last, -1)[:, self._first :])
        energy = self._drive_energy
        if quiet:
            energy = self._quiet_energy(formed[:, quiet]) + _DRIVE * energy
        energy = energy + _RIDGE / len(energy) * np.eye(len(energy))
        aims.choose(energy)
        # Chosen once, for the click that the summed energy makes: every choice costs rows.
        rows = self._drive
        if quiet:
            hardest = self._hardest(pool.transfer[1:OF_ROWS, quiet], aims.closed_form(energy))
            rows = np.empty((len(self._drive) + len(hardest) * self._row_steps, len(energy)), np.float32)
            rows[: len(self._drive)] = self._drive
            self._fill_rows(hardest, self._sparse, 1 / limit, rows[len(self._drive) :])
        weight = self._from_best_instant(rows, energy, aims)
        if not quiet:
            return weight
        under = Responses(np.ascontiguousarray(pool.transfer[OF_ROWS:, quiet]), self._lines)
        change = self._quiet_peak(under, weight, many) / limit / self._drive_share(weight)
        # Only the rows of plants change, so the drive's limit stays where it is.
        rows[len(self._drive) :] *= np.float32(np.clip(change, _LEAST_CHANGE, _MOST_CHANGE))
        weight = self._reweighted(rows, weight, energy, aims, _AGAIN)
        # Whichever limit binds: a click that is scaled keeps its shape, so nothing is solved again.
        return weight / max(self._drive_share(weight), self._quiet_peak(under, weight, many) / limit)

    def _from_best_instant(self, rows: Single, energy: Array, aims: "_Aims") -> Array:
        """Weights from the one of the likeliest instants that is best after the early steps."""
        found = list[Array]()
        for _ in aims.try_instants():
            found.append(self._reweighted(rows, aims.closed_form(energy), energy, aims, _EARLY))
        peaks = [aims.follow(weight) for weight in found]
        return self._reweighted(rows, found[int(np.argmax(peaks))], energy, aims, _LATE)

    def _reweighted(self, rows: Single, weight: Array, energy: Array, aims: "_Aims", exponents: Sequence[int]) -> Array:
        """Weights of a stronger click whose greatest row is 1."""
        value = rows @ weight.astype(np.float32)
        change, scaled = np.empty_like(value), np.empty_like(rows)
        for exponent in exponents:
            least = aims.follow(weight)  # the weakest felt peak is 1 throughout, and the greatest row is what shrinks
            weight, value = weight / least, value / np.float32(least)
            kept = _scale_rows(rows, value, exponent, _EVERY if exponent <= _THINNED else 1, scaled)
            form = (scaled[:kept].T @ scaled[:kept]).astype(np.float64)
            form += _ENERGY * np.trace(form) * energy  # fewer rows than tones may count
            step = aims.closed_form(form) - weight
            np.matmul(rows, step.astype(np.float32), out=change)
            part = float(_STEPS[_best_step(value, change, exponent, _STEPS)])
            weight, value = weight + part * step, value + np.float32(part) * change
        return weight / float(np.abs(value).max())

    def _quiet_energy(self, transfer: Complex32) -> Array:
        """Form (tone, tone) of trace 1: energy under fingers, from transfer (plant, finger, actuator, line)."""
        every = transfer.reshape(-1, *transfer.shape[2:])
        out = np.empty((len(self._spectrum),) * 2)
        for i, mine in enumerate(self._own):
            for j, others in enumerate(self._own[: i + 1]):  # the form is symmetric
                product = _sum_of_products(every, i, j) * self._line_weight
                one = np.ascontiguousarray(self._spectrum[mine] * product)
                block = one.view(np.float32) @ np.ascontiguousarray(self._spectrum[others]).view(np.float32).T
                out[np.ix_(mine, others)], out[np.ix_(others, mine)] = block, block.T
        return out / np.trace(out)

    def _fill_rows(self, transfer: Complex32, lines: DampedLines, factor: float, rows: Single) -> None:
        """Fill rows (course and time, tone) with factor times the response to each tone.

        transfer (course, actuator, line).
        """
        out = rows.reshape(len(transfer), -1, rows.shape[1])
        growth = lines.growth[: out.shape[1], None] * np.float32(factor * lines.rate_hz / SAMPLE_RATE_HZ)
        for start in range(0, len(transfer), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            spectrum = transfer[part, self._tones.actuator] * self._spectrum
            course = lines.period(spectrum)[..., : out.shape[1]]
            np.multiply(course.transpose(0, 2, 1), growth, out=out[part])

    def _hardest(self, under: Complex32, weight: Array) -> Complex32:
        """Transfer (course, actuator, line) of the plants whose peaks are the highest of those that keep the limit.

        under (plant, finger, actuator, line), the fingers each with as many plants.
        """
        # At half the rate: a rank needs no exact peaks.
        drive = np.stack([weight[mine].astype(np.float32) @ self._spectrum[mine] for mine in self._own])
        course = self._sparse.period(combine(under.reshape(-1, *under.shape[2:]), drive))[:, : self._row_steps]
        peak = np.abs(course * self._sparse.growth[: self._row_steps]).max(axis=1).reshape(under.shape[:2])
        kept = np.argsort(peak.max(axis=1))[: round(len(peak) * SHARE / 100)]
        fingers = under.shape[1]
        count = min(max(_COURSES // fingers, _COURSES_OF_A_FINGER), _MOST_COURSES // fingers)
        highest = np.argsort(peak[kept], axis=0)[-count:]
        return under[kept[highest], np.arange(fingers)].reshape(-1, *under.shape[2:])

    def _drive_share(self, weight: Array) -> float:
        """The greatest row of the drive: 1 at its limits."""
        return float(np.abs(self._drive @ weight).max())

    def _quiet_peak(self, under: Responses, weight: Array, many: ManyPlants) -> float:
        """95th percentile over plants of the strongest quiet finger's peak."""
        course, peak = under.played(self._tones.waveform(weight))
        return float(many.percentiles(course, peak.max(axis=1), (SHARE,))[0])


class _Aims:
    """Instant and sign of every felt finger's peak, from rows (finger, time, tone) of the mean plant."""

    def __init__(self, rows: Single) -> None:
        self._rows = rows
        self._single = rows.reshape(-1, rows.shape[2])
        self._offset = np.arange(len(rows)) * rows.shape[1]
        self._aim: Array = np.empty((0, 0))
        self._maxima = np.zeros(0, np.int64)

    def choose(self, energy: Array) -> None:
        """Choose the instants and signs of the least energy (tone, tone)."""
        factor, _ = dpotrf(energy, lower=1)
        columns, _ = dtrtrs(factor, self._single.T.astype(np.float64), lower=1)
        alone = np.einsum("ij,ij->j", columns, columns).reshape(len(self._rows), -1)
        if len(self._rows) == 1:
            self._maxima = _greatest_maxima(alone[0])
            self._take(self._maxima[:1], np.ones(1))
        else:
            self._maxima = np.zeros(0, np.int64)
            likely = np.argsort(-alone, axis=1)[:, :_LIKELY]
            self._take(*_least_together(columns, likely + self._offset[:, None], likely))

    def try_instants(self) -> Iterator[None]:
        """Take the likeliest instants of one felt finger in turn; several fingers keep those that they have."""
        yield
        for instant in self._maxima[1:_TRIED]:
            self._take(np.array([instant]), np.ones(1))
            yield

    def follow(self, weight: Array) -> float:
        """Move every instant to the peak of its finger; returns the least of the peaks."""
        value = (self._single @ weight.astype(np.float32)).reshape(len(self._rows), -1)
        instant = np.abs(value).argmax(axis=1)
        peak = value[np.arange(len(value)), instant]
        self._take(instant, np.sign(peak))
        return float(np.abs(peak).min())

    def closed_form(self, form: Array) -> Array:
        """Weights of the least x form x of which every felt finger has 1 or more at its instant, the weakest 1."""
        _, columns, _ = dposv(form, self._aim.T, lower=1)
        held = np.arange(len(self._aim))
        weight: Array = columns[:, 0]
        while len(held) > 1:
            price = np.linalg.solve(self._aim[held] @ columns[:, held], np.ones(len(held)))
            weight = columns[:, held] @ price
            if (price > 0).all():
                break
            held = np.delete(held, price.argmin())  # this finger exceeds 1 by itself
            weight = columns[:, held[0]]
        return weight / (self._aim @ weight).min()

    def _take(self, instant: Integers, sign: Array) -> None:
        self._aim = self._single[self._offset + instant] * sign[:, None]


def _least_together(columns: Array, index: Integers, instant: Integers) -> tuple[Integers, Array]:
    """Instants and signs (finger,) of the least g (Z^T Z)^-1 g, one finger after another; columns Z (tone, instant).

    index, instant (finger, likely): columns of each finger's likely instants, and the instants that they stand for.
    """
    fingers = len(index)
    chosen, sign = np.zeros(fingers, np.int64), np.ones(fingers)
    likely = [columns[:, each] for each in index]
    least = np.inf
    for _ in range(_TURNS):
        for f in range(fingers):
            # With the others held, the least energy as finger f varies is a block inverse (Schur complement).
            others = [k for k in range(fingers) if k != f]
            held = np.stack([likely[k][:, chosen[k]] for k in others], axis=1)
            inverse = np.linalg.inv(held.T @ held)
            cross = likely[f].T @ held
            own = np.einsum("ij,ij->j", likely[f], likely[f])
            left = np.maximum(own - np.einsum("ti,ij,tj->t", cross, inverse, cross), 1e-12 * own)
            before = sign[others] @ inverse @ sign[others]
            for side in (1.0, -1.0):
                energy = before + (side - cross @ (inverse @ sign[others])) ** 2 / left
                best = int(energy.argmin())
                if energy[best] < least:
                    least, chosen[f], sign[f] = energy[best], best, side
    return instant[np.arange(fingers), chosen], sign


def _greatest_maxima(value: Array) -> Integers:
    """Indices of the local maxima, the greatest first."""
    padded = np.concatenate([[-np.inf], value, [-np.inf]])
    maxima = np.flatnonzero((value >= padded[:-2]) & (value >= padded[2:]))
    return maxima[np.argsort(-value[maxima])]


def _half_as_dense(lines: DampedLines) -> DampedLines:
    """Lines for courses at half the rate, where the band allows it."""
    half = DampedLines(lines.rate_hz / 2, lines.steps // 2, lines.top_hz)
    return half if len(half.s_per_s) == len(lines.s_per_s) and 2 * half.size == lines.size else lines


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _sum_of_products(transfer: Complex32, one: int, other: int) -> Complex32:
    """Sum over courses of transfer (course, actuator, line) of `one` times the conjugate of that of `other`."""
    out = np.zeros(transfer.shape[2], np.complex64)
    for c in range(len(transfer)):
        for k in range(len(out)):
            out[k] += transfer[c, one, k] * transfer[c, other, k].conjugate()
    return out


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _scale_rows(rows: Single, value: Single, exponent: int, every: int, out: Single) -> int:
    """Fill out with rows times the root of their weights, (|value| / its greatest)^exponent; returns their number.

    exponent: a power of 2. Of the rows each `every`-th is taken, and none with a negligible weight.
    """
    greatest = np.float32(0.0)
    for i in range(len(value)):
        greatest = max(greatest, abs(value[i]))
    kept = 0
    for i in range(0, len(value), every):
        root = np.sqrt(abs(value[i]) / greatest)
        power = 1  # squared until it is the exponent: `**` would take most of the time
        while power < exponent:
            root *= root
            power *= 2
        if root * root > _NEGLIGIBLE:
            for k in range(rows.shape[1]):
                out[kept, k] = root * rows[i, k]
            kept += 1
    return kept


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _best_step(value: Single, change: Single, exponent: int, steps: Single) -> int:
    """Index of the step with the least sum of |value + step * change|^(exponent + 2)."""
    greatest = np.float32(0.0)
    for i in range(len(value)):
        greatest = max(greatest, abs(value[i]))
    scale = np.float32(1.0) / greatest  # powers up to 66 stay within single precision
    weight = np.empty_like(value)
    best, least = 0, np.float32(np.inf)
    for n in range(len(steps)):
        for i in range(len(value)):
            weight[i] = abs(value[i] + steps[n] * change[i]) * scale
        power = 1
        while power < exponent:
            for i in range(len(value)):
                weight[i] *= weight[i]
            power *= 2
        total = np.float32(0.0)
        for i in range(len(value)):
            moved = (value[i] + steps[n] * change[i]) * scale
            total += weight[i] * moved * moved
        if total < least:
            best, least = n, total
    return best
