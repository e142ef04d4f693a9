"""Kernels: the best drive at one frequency, forms (form, actuator, actuator) and responses under felt fingers given.

A drive a (actuator,) has numerators N_i and denominators D_j, all a^H H a, and the level |p_f a|^2 under felt finger
f. Maximise min N / max D subject to min_f |p_f a|^2 >= wanted max_l |a_l|^2:

- One numerator and one denominator: the greatest eigenvalue of N a = lambda D a; closed form for two actuators, power
  iteration beyond. N is nearly of rank one (one finger, a few cases of it), so two or three steps are enough.
- With two actuators and one felt finger, where that drive is not loud enough: the strongest actuator stands at full
  scale, and the other one's amplitude lies on a circle in the complex plane, on which the ratio is (alpha + Re beta e)
  / (gamma + Re delta e) with |e| = 1. Its maximum is a root of a quadratic, or the circle's end at |amplitude| = 1.
- Several fingers: the forms of each side are added with weights, and the weights of the weakest felt and the strongest
  quiet finger grow step by step, by the ratio by which each is weak or strong (Lawson 1961). The drive takes one step
  of the power iteration for each step of the weights, so it follows from frequency to frequency.
- Several fingers or more actuators where that is not loud enough: the powers of the amplitudes join the denominators,
  with one weight nu that is searched for the wanted level, and weights among the actuators as among the fingers.
  Where the felt finger's numerator and its level have one direction this is the Lagrangian of the problem. What is
  left to the level is found along the line to the loudest drive; the ascent (engine.steady.ascent) climbs from there.
"""

import numpy as np
from numba import njit

_TINY = 1e-300
POWER_STEPS = 30
_CONVERGED = 1e-7
_LOUD_STEPS = 8
_LINE_STEPS = 12
_LEVEL_STEPS, _LEVEL_FACTOR = 8, 5.0
_LEAST_WEIGHT = 1e-4


@njit(cache=True)
def power_of(form, a):  # type: ignore[no-untyped-def]  # numba
    """The power a^H H a."""
    total = 0.0
    for i in range(len(a)):
        total += form[i, i].real * (a[i].real * a[i].real + a[i].imag * a[i].imag)
        for j in range(i + 1, len(a)):
            total += 2.0 * (np.conj(a[i]) * form[i, j] * a[j]).real
    return total


@njit(cache=True)
def ratio_of(N, D, a):  # type: ignore[no-untyped-def]  # numba
    """The weakest numerator over the strongest denominator."""
    least, greatest = np.inf, _TINY
    for i in range(len(N)):
        least = min(least, power_of(N[i], a))
    for j in range(len(D)):
        greatest = max(greatest, power_of(D[j], a))
    return max(least, 0.0) / greatest


@njit(cache=True)
def loudness_of(p, a):  # type: ignore[no-untyped-def]  # numba
    """Power over threshold under the weakest felt finger with the strongest actuator at 1; p (finger, actuator)."""
    least, greatest = np.inf, _TINY
    for i in range(len(a)):
        greatest = max(greatest, a[i].real * a[i].real + a[i].imag * a[i].imag)
    for f in range(len(p)):
        response = 0j
        for i in range(len(a)):
            response += p[f, i] * a[i]
        least = min(least, response.real * response.real + response.imag * response.imag)
    return least / greatest


@njit(cache=True)
def _factor(D, lower):  # type: ignore[no-untyped-def]  # numba
    """Cholesky factor of D; a pivot below 1e-12 of the trace is raised to it: a form of few cases may be singular."""
    m = len(D)
    trace = 0.0
    for i in range(m):
        trace += D[i, i].real
    floor = max(1e-12 * trace, _TINY)
    for j in range(m):
        pivot = D[j, j].real
        for k in range(j):
            pivot -= lower[j, k].real ** 2 + lower[j, k].imag ** 2
        root = np.sqrt(max(pivot, floor))
        lower[j, j] = root
        for i in range(j + 1, m):
            s = D[i, j]
            for k in range(j):
                s -= lower[i, k] * np.conj(lower[j, k])
            lower[i, j] = s / root


@njit(cache=True)
def _solve(lower, x):  # type: ignore[no-untyped-def]  # numba
    """Solve L L^H x = b in place."""
    m = len(x)
    for i in range(m):
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i].real
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            x[i] -= np.conj(lower[k, i]) * x[k]
        x[i] /= lower[i, i].real


@njit(cache=True)
def _step(N, lower, a, moved):  # type: ignore[no-untyped-def]  # numba
    """One step of the power iteration: a becomes D^-1 N a, at length 1. False where N a is 0; moved: space for it."""
    m = len(a)
    for i in range(m):
        moved[i] = 0j
        for j in range(m):
            moved[i] += N[i, j] * a[j]
    _solve(lower, moved)
    size = 0.0
    for i in range(m):
        size += moved[i].real ** 2 + moved[i].imag ** 2
    if size <= 0.0:
        return False
    scale = 1 / np.sqrt(size)
    for i in range(m):
        a[i] = moved[i] * scale
    return True


@njit(cache=True)
def solve_dominant(N, D, a, steps, work):  # type: ignore[no-untyped-def]  # numba
    """The greatest lambda of N a = lambda D a and its a in place; `a` is where at most `steps` power iterations start.

    work (3, actuator + 1, actuator): space for factors.
    """
    m = len(a)
    if m == 1:
        a[0] = 1.0
        return N[0, 0].real / max(D[0, 0].real, _TINY)
    if m == 2:
        d = max(D[0, 0].real * D[1, 1].real - abs(D[0, 1]) ** 2, 1e-24 * (D[0, 0].real + D[1, 1].real) ** 2)
        # Half the trace of D^-1 N and the root of the discriminant.
        cross = N[0, 1] * np.conj(D[0, 1])
        middle = 0.5 * (N[0, 0].real * D[1, 1].real + N[1, 1].real * D[0, 0].real - 2 * cross.real) / d
        determinant = (N[0, 0].real * N[1, 1].real - abs(N[0, 1]) ** 2) / d
        value = middle + np.sqrt(max(middle * middle - determinant, 0.0))
        # a is orthogonal to the greater row of N - lambda D.
        x, z = N[0, 0].real - value * D[0, 0].real, N[1, 1].real - value * D[1, 1].real
        y = N[0, 1] - value * D[0, 1]
        if abs(x) >= abs(z):
            a[0], a[1] = y, -x
        else:
            a[0], a[1] = z, -np.conj(y)
        return value
    lower, moved = work[0, :m], work[0, m]
    _factor(D, lower)
    last = 0.0
    for _ in range(steps):
        if not _step(N, lower, a, moved):
            break
        value = power_of(N, a) / max(power_of(D, a), _TINY)
        if value - last <= _CONVERGED * value:
            break
        last = value
    return power_of(N, a) / max(power_of(D, a), _TINY)


@njit(cache=True)
def weigh(N, D, a, felt, quiet, amplitude, nu, steps, work):  # type: ignore[no-untyped-def]  # numba
    """Steps of Lawson's weights and of the drive `a`, both in place: one step of the power iteration for each.

    felt (numerator,), quiet (denominator,), amplitude (actuator,): weights that add up to 1. The denominators are added
    with their weights, and `nu` times the powers of the amplitudes; each of these weighs as it is strong, without
    memory, which leads to the least fourth power instead of the least greatest one and needs few steps.
    """
    m = len(a)
    lower, moved, A, B = work[0, :m], work[0, m], work[1, :m], work[2, :m]
    for _ in range(steps):
        for r in range(m):
            for c in range(m):
                A[r, c], B[r, c] = 0j, 0j
                for i in range(len(N)):
                    A[r, c] += felt[i] * N[i, r, c]
                for j in range(len(D)):
                    B[r, c] += quiet[j] * D[j, r, c]
        for i in range(m):
            B[i, i] += nu * amplitude[i]
        _factor(B, lower)
        if not _step(A, lower, a, moved):
            return
        for i in range(len(N)):
            felt[i] /= max(power_of(N[i], a), _TINY)
        for j in range(len(D)):
            quiet[j] *= power_of(D[j], a)
        for i in range(m):
            amplitude[i] = a[i].real ** 2 + a[i].imag ** 2
        _normalise(felt)
        _normalise(quiet)
        _normalise(amplitude)


@njit(cache=True)
def _normalise(weight):  # type: ignore[no-untyped-def]  # numba
    """Scale weights to a sum of 1; none falls so low that it could not grow again."""
    total = 0.0
    for i in range(len(weight)):
        total += weight[i]
    for i in range(len(weight)):
        weight[i] = max(weight[i] / max(total, _TINY), _LEAST_WEIGHT)


@njit(cache=True)
def approach_level(N, D, p, wanted, a, felt, quiet, amplitude, nu, work):  # type: ignore[no-untyped-def]  # numba
    """Bring `a` near the wanted loudness by raising the weight `nu` of the amplitudes; returns it, for a neighbour.

    Bisection on log nu about the given one, the other weights following. The last drive loud enough is kept.
    """
    if nu <= 0.0:
        for j in range(len(D)):
            for i in range(len(a)):
                nu += 1e-2 * D[j, i, i].real / len(D)
    low, high = 0.0, np.inf
    trial, kept = a.copy(), nu
    for _ in range(_LEVEL_STEPS):
        weigh(N, D, trial, felt, quiet, amplitude, nu, 2, work)
        if loudness_of(p, trial) < wanted:
            low = nu
        else:
            high, kept = nu, nu
            a[:] = trial
        if low == 0.0:
            nu = high / _LEVEL_FACTOR
        elif high == np.inf:
            nu = low * _LEVEL_FACTOR
        else:
            nu = np.sqrt(low * high)
    if high == np.inf:
        a[:] = trial
    return kept


@njit(cache=True)
def find_loudest(p, usable, a):  # type: ignore[no-untyped-def]  # numba
    """Fill `a` with the drive of full amplitudes that is loudest under the weakest felt finger; its loudness.

    One felt finger: every actuator in phase there, which is the optimum. Several: steps that raise the sum of weighted
    powers at unit amplitudes, with Lawson's weights, started in phase under each finger in turn.
    """
    fingers, m = p.shape
    best = -1.0
    trial, weight = np.empty(m, dtype=np.complex128), np.empty(fingers)
    for start in range(fingers):
        for i in range(m):
            trial[i] = np.conj(p[start, i])
        weight[:] = 1.0 / fingers
        for _ in range(1 if fingers == 1 else _LOUD_STEPS):
            for i in range(m):
                size = abs(trial[i])
                trial[i] = trial[i] / size if usable[i] and size > 0 else 0j
            value = loudness_of(p, trial)
            if value > best:
                best = value
                a[:] = trial
            if fingers == 1:
                break
            total = 0.0
            moved = np.zeros(m, dtype=np.complex128)
            for f in range(fingers):
                response = 0j
                for i in range(m):
                    response += p[f, i] * trial[i]
                weight[f] /= max(abs(response) ** 2, _TINY)
                total += weight[f]
            for f in range(fingers):
                weight[f] /= total
                response = 0j
                for i in range(m):
                    response += p[f, i] * trial[i]
                for i in range(m):
                    moved[i] += weight[f] * np.conj(p[f, i]) * response
            trial[:] = moved
    return best


@njit(cache=True)
def keep_level(N, D, p, usable, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """Move `a` towards the loudest drive until it is loud enough; its ratio, or -1 where no drive is."""
    m = len(a)
    loud, trial = np.empty(m, dtype=np.complex128), np.empty(m, dtype=np.complex128)
    if find_loudest(p, usable, loud) < wanted:
        return -1.0
    # Bring both to the same phase under the first felt finger and to the same strongest amplitude.
    own, other, strongest = 0j, 0j, 0.0
    for i in range(m):
        own += p[0, i] * a[i]
        other += p[0, i] * loud[i]
        strongest = max(strongest, abs(a[i]))
    turn = own * np.conj(other)
    turn = turn / abs(turn) if abs(turn) > 0 else 1.0 + 0j
    low, high = 0.0, 1.0
    for _ in range(_LINE_STEPS):
        middle = 0.5 * (low + high)
        for i in range(m):
            trial[i] = (1 - middle) * a[i] / max(strongest, _TINY) + middle * turn * loud[i]
        if loudness_of(p, trial) >= wanted:
            high = middle
        else:
            low = middle
    for i in range(m):
        a[i] = (1 - high) * a[i] / max(strongest, _TINY) + high * turn * loud[i]
    return ratio_of(N, D, a)


@njit(cache=True)
def solve_on_limit(N, D, p, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """Two actuators, one felt finger, the level binding: the best drive in place and its ratio, or -1.

    N, D (2, 2); p (2,).
    """
    best = -1.0
    found = np.empty(2, dtype=np.complex128)
    for full in range(2):  # the actuator at full scale; the other one's amplitude is x
        other = 1 - full
        if abs(p[other]) < 1e-12 * (abs(p[full]) + _TINY):
            continue
        # |p_l + p_o x|^2 = wanted: the circle x = c + r e.
        c, r = -p[full] / p[other], np.sqrt(wanted) / abs(p[other])
        n, d = (N[0, 1], D[0, 1]) if full == 0 else (N[1, 0], D[1, 0])
        square = abs(c) ** 2 + r * r
        alpha = N[full, full].real + 2 * (n * c).real + N[other, other].real * square
        beta = 2 * r * (n + N[other, other].real * np.conj(c))
        gamma = D[full, full].real + 2 * (d * c).real + D[other, other].real * square
        delta = 2 * r * (d + D[other, other].real * np.conj(c))
        # alpha - t gamma + |beta - t delta| = 0 at the maximum t of the ratio over the circle.
        a2 = max(gamma * gamma - abs(delta) ** 2, _TINY)
        a1 = alpha * gamma - (beta * np.conj(delta)).real
        t = (a1 + np.sqrt(max(a1 * a1 - a2 * (alpha * alpha - abs(beta) ** 2), 0.0))) / a2
        e = np.conj(beta - t * delta)
        x = c + r * (e / abs(e) if abs(e) > 0 else 1.0 + 0j)
        count = 1
        first = second = x
        if abs(x) > 1.0:
            # Outside of full scale: the ends of the arc inside, where both actuators are at full scale.
            distance = abs(c)
            along = (distance * distance + 1.0 - r * r) / max(2 * distance, _TINY)
            if along > 1.0 or along < -1.0:
                continue
            across = np.sqrt(1.0 - along * along)
            count = 2
            first, second = c / distance * complex(along, across), c / distance * complex(along, -across)
        for i in range(count):
            found[full], found[other] = 1.0, first if i == 0 else second
            value = power_of(N, found) / max(power_of(D, found), _TINY)
            if value > best:
                best = value
                a[:] = found
    return best
