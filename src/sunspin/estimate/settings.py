"""Numbers that tune the estimation, with unit, meaning, and what set them.

The thresholds of the verdict are in :mod:`sunspin.estimate.verdict`: they follow from error rates and are not tuned. Constants that
concern only the accuracy of a computation are next to that computation. "Turn": rotation of the body, in rad. "Costs": minus the
log of the posterior density.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PassSettings:
    """How the samples of a file are divided into passes, and which samples of a pass the search keeps."""

    gap_intervals: float = 6.0
    """A gap separates two passes if it is longer than this many median intervals."""

    longest_s: float = 3000.0
    """Longer passes are cut: over half an orbit the random changes of a rate still turn the body little."""

    longest_field_s: float = 1000.0
    """Longest pass if a magnetometer is read. Without an orbit the rotation of the field is taken as uniform, which holds for a
    sixth of an orbit: over half an orbit rates of simulated spinners were off by 0.03 deg/s at a stated sigma of 0.014."""

    most_in_field: int = 500
    """With an orbit `longest_field_s` holds only for passes that would have more samples than this. Kept samples 70 s apart, four
    revolutions at 21 deg/s, left two of four passes undecided. Slow bodies, read every 10 s, need the longer pass."""

    longest_dark_s: float = 300.0
    """A pass does not end if panels show no Sun for less than this and a magnetometer is read. The shadow of the Earth lasts
    longer. A body with one panel and a revolution of 28 s had a pass for each revolution."""

    most_kept: int = 40
    """Most samples of a pass that the search keeps."""

    growth: float = 1.4
    """Largest ratio of neighbouring intervals of the kept samples. They begin with the intervals of the file and widen to even
    ones, so that the rate known from some samples always predicts the next one."""

    dense: int = 12
    """Samples close together among which a search finds its first pairs; they lie where most of so many show the Sun."""


@dataclass(frozen=True)
class SearchSettings:
    """How motions are searched: where starts are placed, how the window of samples grows, and which candidates are dropped."""

    noise: float = 1e-4
    """rad/s^1.5; unknown torques that the search assumes, also for a quiet body: under weaker ones fits move by short steps
    only."""

    basin_rad: float = 0.35
    """Radius of a basin: a start whose turns at the samples of its window are nearer to the truth than this ends in the truth."""

    step_rad: float = 0.35
    """Spacing of the turns, as rotation vectors, that are tried between two Sun directions: none is farther than half a basin."""

    most_starts: int = 200_000
    """Most starts of one pair of samples; a grid of rates becomes coarser to keep within it."""

    most_turns: int = 100
    """Most whole revolutions between two samples: if both hardly bound the Sun direction, more would make millions of starts."""

    least_drift_rad: float = 5e-3
    """If a body turns by less than this in the sigma of a sample's time, times count as exact: it is half of the usual error of a
    direction."""

    large_drift_rad: float = 0.03
    """If a body turns by more than this in that sigma, motions are searched again with the errors of the times."""

    around: int = 2
    """Samples on either side of the first pair on which the starts of the pair are tried."""

    crowd: int = 3000
    """With more starts than this, they are tried on the pair alone first, then on four samples."""

    tried: tuple[int, int, int] = (6_000, 1500, 120)
    """Most starts that are kept after they were tried on the pair alone, on four samples, and on the first window."""

    growth: float = 1.33
    """Factor by which the number of samples in the window grows. An error of the rate turns the ends of the wider window by 4/3 of
    what it turned those of the window that was fitted."""

    steps: int = 4
    """Gauss-Newton steps of the fit in each window. A fit that has not converged goes on in the next window."""

    steps_if_inertia_free: int = 8
    """The same if the errors of the inertia are unknowns. After four steps in the first window a true motion cost 38, 30 more than
    the best, and was dropped; after eight it was within 2 of the best."""

    most: int = 32
    """Most candidates kept while the window grows. A search that drops others for this limit still counts as complete."""

    drop: float = 18.0
    """A candidate is dropped if its log probability is below that of the best by more than this."""

    drop_if_rounded: float = 9.0
    """Factor on `drop` if times were rounded and their errors are not yet known: these make residuals three times as large."""

    copies_rad: float = 0.25
    """Candidates whose turns between neighbouring samples differ by less are copies: half the least distance of mirror images."""

    copies_sigmas: float = 3.0
    """Candidates whose rates differ by less than this many of their own sigmas lie in one valley, and are copies too."""

    valley_sigmas: float = 2.5
    """How far along the weakly constrained direction of the rate further candidates are placed. Farther ones would cost 3 more."""

    valley_each: int = 8
    """Most further candidates on either side of one."""

    valley_most: int = 16
    """Most further candidates for one window: with 64 no more of 100 slow bodies got their true motion."""

    valley_fits: float = 0.4
    """A candidate gets further ones only if it costs less than this share of `cost_limit`, so that it fits."""

    valley_leading: float = 6.0
    """A candidate that costs more than the best by this gets no further ones."""

    places: int = 3
    """Pairs of samples from which the search starts, unless one is enough (:func:`sunspin.estimate.starts.pairs_to_try`)."""

    places_if_flat: int = 4
    """Pairs to start from if panels lie in one plane or share inputs, and so hardly bound the Sun direction."""

    more_places: int = 2
    """Further pairs to start from if the best candidate does not fit."""

    good_enough: float = 0.8
    """The search counts a candidate as fitting if it costs less than this share of `cost_limit`."""

    watch: Callable[[Any, Any], None] | None = None
    """Function that is called with each window and its candidates, to see which stage dropped a motion."""


@dataclass(frozen=True)
class LadderSettings:
    """Strengths of unknown torques ("rungs"), equally likely before the data, and how motions are fitted under each."""

    rungs: tuple[float, ...] = (5e-6, 2e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
    """rad/s^1.5; at 3e-4 a rate changes by 0.3 deg/s in five minutes. Below the lowest the evidence is dominated by rounding."""

    strong: float = 1e-3
    """Rung under which a body is searched again if its inertia may be wrong: torques then make up for that."""

    strained: float = 3e-4
    """If only the Sun is measured and the most probable rung is at least this, the body is searched again under `strong`, though
    its motion fits. Without an inertia a body at 12.5 deg/s, sampled every 30 s, was decided as one at 0.2 deg/s; a long body whose
    inertia was a sigma off was decided 13 sigma off."""

    cooling: float = 5.5
    """Largest ratio of two strengths under which a motion is fitted one after the other: after a larger one a fit hardly moves."""

    steps: int = 8
    """Most steps of a fit on a rung that begins where the one before ended."""

    first_steps: int = 20
    """Most steps of the fit on the first rung."""

    tolerance: float = 1e-3
    """Predicted gain in cost below which a fit ends: 0.045 sigma. With a tenth of it fits of few samples take 1.4 times the steps,
    as many of them overshoot, and no log evidence changes by more than 0.012."""

    creeping: float = 1.0
    """A motion whose cost rises by more than this from one rung to the next may not have reached its minimum: it is fitted further
    by steps along the equations of motion. Fitting all motions like this took twice the time of passes with few samples."""

    stiff_rad: float = 0.1
    """Only torques that turn the body by less than this in half of the pass are weak enough for such a further fit."""

    hopeless: float = 18.0
    """A motion, or a rung, is given up if its log evidence is below the best by this."""

    beyond_fit: float = 3.0
    """Sigmas of a torque that exceed the fitted one by more than this factor get no evidence: linear theory does not hold there."""

    low_orbit_rad_s: float = 1.1e-3
    """Orbital rate n, rad/s, that is assumed if the gravity gradient is not modelled: that at 600 km. The gradient there changes
    the rate of a long body by 0.1 deg/s in half an hour."""

    gradient_share: float = 1 / 6
    """Acceleration by the gradient that is assumed for a slow body, as a share of the largest one, 3/2 n^2 (C - A) / B. Of 12
    passes of a 3U CubeSat at 0.04 to 0.18 deg/s 8 were decided before, and three of these were 4.0 to 4.7 sigma off. With this
    share 5 are decided, and all are within 1.9 sigma; with half of the largest, its mean over all attitudes, none is decided."""

    common: float = 0.75
    """Share of the prior of the rungs that comes from the other passes of the file; the rest is even."""


@dataclass(frozen=True)
class AlternativeSettings:
    """When alternative models of a pass are tried, and their priors."""

    hopeless: float = 6.0
    """An alternative is followed if its log evidence is below the best model's by at most this: beyond, it counts for 0.2 %."""

    doubted: float = 1.0
    """If the errors of an uncalibrated magnetometer raise the log evidence by this, the search is repeated with them in its
    noise."""

    most_steps: int = 4
    """Most steps of the rate in a pass."""

    step_sizes: float = float(np.log(np.log(100.0)))
    """Cost in log evidence of fitting the size of a step that is known only to a factor of a hundred before the data."""

    torque_turns_rad: tuple[float, ...] = tuple(np.radians(np.geomspace(1.0, 300.0, 6)).tolist())
    """Sigmas of the turn of the body over a pass by a constant torque, equally likely: not even its power of ten is known."""

    tilt_shows: float = 2.0
    """Misaligned panels are tried if two angles of one panel reduce half the sum of squared residuals by this. In 18 passes with
    right panels it was 0.0 to 1.8, with panels misaligned by 3 degrees 2.4 and more. The evidence decides; this saves time."""

    zero_odds: float = float(np.log(0.05 / 0.95))
    """Log odds that the zero offset of a gyro differs from the stated one by more than the vehicle file states."""

    drift_odds: float = float(np.log(0.2 / 0.8))
    """Log odds that the zero offset of a gyro drifts noticeably within a pass, as in a small gyro whose temperature changes."""

    gyro_scale_sigma: float = 0.02
    """Relative sigma of the scale of a gyro for which the vehicle file states none."""

    swings_rad: tuple[float, ...] = (0.15, 0.3, 0.6, 1.2)
    """Sigmas of the turn about each axis between two samples by an oscillation of the body; each is a model of its own."""

    even_rad: float = 0.5
    """Samples are evenly spaced if a whole revolution in the shortest interval is one in all others, to this error."""

    momentum_off_rad: float = 0.35
    """Aliases about two axes are tried if the angular momentum of their rates is less than this away from its direction in space.
    In a pass that was decided as an alias without them it is 0.1."""

    beyond: float = 2.0
    """Factor on the largest rate up to which a fast body without an inertia is searched if no largest rate is stated, and 1 rad/s
    at most. The prior of the rate stays as it is, so that a faster motion must fit better. With an inertia such a search takes as
    long as all the rest, and of 6 passes it changed one, for the better."""


@dataclass(frozen=True)
class SolutionSettings:
    """Which motions under several models are one solution, and which are reported."""

    counted: float = 0.01
    """Motions of a model with less than this part of the largest probability are left out."""

    bent_rad: float = 1.0
    """Largest difference of turns between two samples of one motion under two models; others mostly differ by whole revolutions."""

    most: int = 6
    """Most solutions reported for each pass."""

    least: float = 1e-3
    """Solutions of less probability are not reported."""

    slower: tuple[float, ...] = tuple(np.geomspace(1.0, 1 / 30, 6).tolist())
    """Upper limits of the rate, as parts of the largest one, equally likely in a prior under which a rate may be of any size."""

    named: float = 0.05
    """The most probable alternative model is named in the result if the nominal one has less than this probability."""


@dataclass(frozen=True)
class RatesSettings:
    """Everything that tunes `rates`."""

    passes: PassSettings = PassSettings()
    search: SearchSettings = SearchSettings()
    ladder: LadderSettings = LadderSettings()
    alternatives: AlternativeSettings = AlternativeSettings()
    solutions: SolutionSettings = SolutionSettings()


RATES = RatesSettings()
"""What `rates` uses by default."""


@dataclass(frozen=True)
class SamplingSettings:
    """How the posterior about fitted motions is drawn: importance sampling along ridges (docs/posterior.md)."""

    rounds: int = 16
    """Most rounds of draws."""

    weak_rad: float = 0.25
    """A direction of rate and Sun is weakly constrained if its sigma for fixed unknowns, as a turn within the window, is larger.
    Philae's second one has 0.08 (5.3 if the unknowns vary): as an outer coordinate it left 45 effective draws of 16,000."""

    most_weak: int = 2
    """Most weakly constrained directions."""

    trace: int = 180
    """Points at each width from which the curve of a ridge is learnt: four for each term of the regression of a lander. With 100
    the log evidence of a curved ridge was short by 0.1 instead of 0.03, though Philae's draws were as good."""

    trace_small: int = 70
    """Points at each width for a ridge that by Laplace's method has less than `small` of the probability of the likeliest."""

    trace_widths: tuple[float, ...] = (0.3, 0.7, 1.3)
    """How far from its motion a ridge is followed, in sigmas of Laplace's method, one after the other."""

    small: float = 0.01
    """See `trace_small`."""

    draws: int = 1000
    """Draws of each round, of all ridges together. With 2000 the first proposal, of whose draws one in twelve counts, makes twice
    as many."""

    block: int = 500
    """Draws that are computed together: their derivatives are kept in memory."""

    wanted: float = 1000.0
    """Effective draws with which sampling ends; a verdict needs 700. They leave the log evidence uncertain by 0.03."""

    good_tail: float = 0.5
    """Pareto index k of the weights with which sampling ends; a verdict needs 0.55 or less."""

    freedom: float = 5.0
    """Degrees of freedom of the Student laws: heavier than the tails of a posterior with a few unknowns."""

    widened: float = 1.3
    """Factor on the covariances of Laplace's method in the first round."""

    inner_width: float = 1.1
    """Factor on the sigmas of the stiff coordinates for given outer ones."""

    reading_draws: int = 8
    """Sets of gains, brightness and misalignments that are drawn for each motion. With one, an improbable set once left 416
    effective draws of 16,000."""

    reading_step: float = 2.0
    """Longest step to their best values, in sigmas of the prior."""

    defence: float = 0.15
    """Part of the proposal for outer coordinates that stays with Laplace's method, with twice its covariance, in all rounds."""

    least: float = 5e-5
    """A ridge with less probability than this, relative to the likeliest, is left out. Solutions are listed down to twice this."""

    most_ridges: int = 60
    """Most ridges that are drawn."""

    on_ridge: float = 9.0
    """A fitted motion lies on the ridge of another if its squared distance in sigmas, over the number of coordinates, is less."""

    far_torque: float = 3.0
    """Linear theory of a torque is not used beyond this many of the sigmas of a share."""

    points_per_term: float = 1.5
    """Least number of draws for each term of a regression."""

    thin: float = 0.75
    """A combination of outer coordinates is thin if its sigma is less than this part of that for independent coordinates. It then
    follows the others by a quadratic. With samples two minutes apart, friction and moments of Philae have two such, of 0.02 and
    0.03: 609 effective draws of 16,000 without the quadratic, 3,295 of 12,000 with it."""

    straight: float = 0.9
    """The quadratic is used only if it reduces the sigma of the combination to less than this part."""

    draws_per_term: float = 3.0
    """Least number of effective draws for each term of that quadratic."""

    off_ridge: float = 6.0
    """Draws farther from the regression than this many times the median are left out of it."""

    connected: float = 0.02
    """Ridges that share this part of the posterior of one of them are one solution."""

    no_weight: float = 1e-5
    """A model with less probability is left out."""

    one_region: float = 9.0
    """Squared distance, in sigmas of the wider, below which solutions under two models are one."""

    bent_rad: float = 1.0
    """Largest difference within the window of one motion under two models, rad; others differ by whole revolutions."""

    sun_rad: float = 0.3
    """Largest difference of the Sun direction at the reference time of one motion under two models, rad."""

    checked: int = 100
    """Draws for which readings are simulated."""

    copies: int = 10
    """Sets of readings that are simulated for each of these draws."""

    cold_runs: float = 12.0
    """Propagated motions for which a draw of the first round counts in the computing budget."""

    warm_runs: float = 3.0
    """Propagated motions for which a draw of later rounds counts."""


SAMPLING = SamplingSettings()
"""How draws are made by default."""


@dataclass(frozen=True)
class OrbitSettings:
    """How an orbit is compared with telemetry. The first seven set the error rates of the verdict."""

    copies: int = 50
    """Comparison orbits, of random node and phase."""

    better: int = 1
    """Most comparison orbits that may fit better: right elements are refused once in 50 times at most."""

    times: float = 1.3
    """Elements are refused if another node makes the residuals smaller by this factor. On skCUBE, whose plane is known, errors of
    the sensor let some nodes do so by 1.05."""

    times_undecided: float = 1.15
    """They are not decided if another node does so by this factor: of 60 simulated satellites it was at most 1.08 with the right
    node, and at least 1.18 with one that is off by 20 degrees."""

    mistaken: float = 0.2
    """If more comparison orbits than this are expected to win by chance against right elements, the data cannot rank orbits."""

    clearly: float = 12.0
    """Log likelihood by which another clock, or a field of the opposite sign, must fit better to be named."""

    mirrored: float = 0.5
    """A field is reported as reversed if its reversal reduces the error of its angle to the Sun to less than this part."""

    nodes_deg: tuple[float, ...] = (-24.0, -12.0, -6.0, -3.0, 3.0, 6.0, 12.0, 24.0)
    """Other nodes that are tried, relative to that of the elements."""

    hours: tuple[int, ...] = (*range(-12, 0), *range(1, 15))
    """Errors of a clock that are tried: those of time zones."""

    samples: int = 200
    """Most samples of the file that are compared."""

    span: float = 3.0
    """The along-track offset is searched within this many of its sigmas."""

    step_s: float = 20.0
    """Steps of the offset, s; they are wider if `most_steps` do not cover the span."""

    most_steps: int = 37
    """Most offsets that are tried."""

    near: float = 60.0
    """A comparison orbit is fitted at a third of the offsets; at all of them if its cost is within this of the one that counts."""

    most_scatter: tuple[float, float] = (0.1, 3.0)
    """Largest noise that is assumed if no orbit fits: of the field's strength, relative, and of the Sun, in its sigmas."""

    fine: int = 33
    """Finer steps among which the offset is estimated."""

    deep: float = 10.0
    """The finer steps cover all offsets whose cost is at most this much above the least, so that every minimum counts."""

    blocks: int = 8
    """Parts of the file that are left out in turn for the sigma of the offset (jackknife)."""

    around: int = 9
    """Offsets within three sigmas that are tried without each part."""

    few: float = 1.15
    """Factor on a sigma from so few parts, so that 90 % lie within 1.645 of it: Student's law, 7 degrees of freedom."""


ORBIT = OrbitSettings()
"""What the check of an orbit uses by default."""


# Priors for satellites.

INERTIA = 0.01
"""If the vehicle file states no sigma of the inertia: relative sigma of each moment, and sigma of each product in mean moments. If
they counted as exact, every sigma of a result would be too small."""

UNKNOWN_MOMENT, UNKNOWN_PRODUCT = 0.3, 0.1
"""Without an inertia: sigmas of each moment and product about a sphere, in mean moments. The moments of a 3U CubeSat are 0.7 below
and 0.4 above their mean."""

UNKNOWN_SHARES = (1.0, 0.4)
"""Parts of these sigmas, equally likely: for long bodies, and for 1U CubeSats, whose moments differ by 5 to 10 %. A slower alias
needs a body farther from a sphere. With the wide sigmas alone a wrong alias was decided in 6 of 13 sparse passes of fast bodies
without an inertia, with both in 3; of 61 other cases none changed its outcome."""

INERTIA_SIGMAS = 4.0
"""No trial inertia or gain is farther from the vehicle file than this many of its sigmas."""

LARGEST_RATE = 1.0
"""rad/s; default limit of the search: every sixth of a revolution more between two samples is another start."""

LARGEST_TURNS = 1.5
"""Revolutions in the shorter intervals that limit the default search too."""

GYRO_ZEROS = tuple(np.radians([3.0, 0.95, 0.3, 0.095, 0.03, 0.003]).tolist())
"""rad/s; sigmas of a gyro's zero offset if the vehicle file states none, equally likely; the last one means no offset."""

GYRO_DRIFTS = tuple(np.radians([0.3, 0.1, 0.03]).tolist())
"""rad/s; sigmas of the change of a gyro's zero offset from the middle of a pass to its end, equally likely, if it drifts."""

FIELD_TURN = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field rotate at about twice its orbital rate of 1.1e-3 rad/s."""

EARTH_WIDER, EARTH_ZERO, EARTH_KNOWN = 1.5, 0.3, 0.25
"""Relative to the mean reading of panels that face away from the Sun: prior sigma of the albedo vector, and of a constant excess of
each panel. Last, the part of the albedo that is unknown in direction and change if the orbit is known: clouds and coasts."""

DIPOLE_SIZES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
"""rad/s2; sigmas of the acceleration by an unknown magnetic dipole, equally likely. 0.005 A m2 on a 1U CubeSat cause the first."""


# Priors for a lander.

LANDER_LARGEST_RATE = 0.6
"""rad/s; largest rate that is searched unless the vehicle file or the caller states another."""

WHEEL_SPEED, FRICTION = 0.005, 0.05
"""Relative sigmas of a wheel's speed and friction if the vehicle file states none. If they counted as exact, every sigma of a
result would be too small."""

BRIGHTNESS_KNOWN, BRIGHTNESS_FREE = 0.06, 1.0
"""Sigma of the logarithm of the brightness if gains have a unit (cell temperature, distance) and if they are relative."""

NOISE_STATED, NOISE_UNSTATED = 0.3, 1.0
"""Sigma of the logarithm of the noise about what the vehicle states, and about what is assumed if it states none."""

LOOSER_INERTIA, LOOSER_CHANCE = 5.0, 0.05
"""Factor on the sigmas of the inertia if that of the file is wrong, and the prior probability of this."""

TORQUE_TURNS_DEG = (1.0, 300.0, 6)
"""Least and largest turn of the body over the samples by an unknown constant torque, and the number of equally likely sizes between
them: not even its power of ten is known."""

OUTLIER, OUTLIER_DARK, OUTLIER_LARGEST = 0.02, 0.5, 1.5
"""Probability that a reading of a lander's panels is an outlier, one that has nothing to do with the Sun; that an outlier is dark;
and the upper limit of a lit outlier, over the largest reading, below which all values are equally likely."""


@dataclass(frozen=True)
class GridSettings:
    """Where motions of a lander are searched: reference sample, a grid of rates there, and fits of starts between its points."""

    turn_rad: float = 1.6
    """Difference of neighbouring grid points at the farthest sample that is tried; interpolated attitudes then err by 0.05 rad."""

    amplified: float = 1.15
    """Turn (rad) per rate (rad/s) and time (s): above one, because a wheel or unequal moments make the body nutate."""

    between_rad: float = 0.08
    """Largest error of nine in ten attitudes half way between propagated grid points. Elsewhere the error is half of it, and less
    than that of interpolation in a cell. For Philae every third point is propagated along each axis, one of 27."""

    near_rad: float = 0.35
    """Radius that a point of a cell stands for: points are a quarter of a cell's edge apart."""

    far_rad: float = 0.65
    """Radius that the middle of an eighth of a cell stands for."""

    node_rad: float = 0.03
    """Largest distance of a direction from its node on a cube of `nodes` cells along an edge. Readings are compared at nodes."""

    nodes: int = 48
    """Cells along an edge of the cube of nodes."""

    brightness: float = 0.08
    """Relative error of brightness and gains that the search for starts assumes."""

    sigmas: float = 3.0
    """A reading contradicts a point if it is off by more sigmas than this, by the square of the excess."""

    cap: float = 16.0
    """Largest such square of one reading: it may be an outlier."""

    largest_misfit: float = 1e6
    """Largest such square while the points of an eighth of a cell are compared with each other."""

    limit: float = 20.0
    """A point is dropped if the readings of one sample contradict it by this."""

    directions: int = 3000
    """Directions on the sphere, 3.7 degrees apart, of which those that the reference sample allows are starts."""

    directions_rad: float = 0.3
    """Radius of the directions that a start stands for."""

    blur_rad: float = 0.07
    """Error of interpolated attitudes and of the brightness, added to the noise while starts are fitted."""

    settled: float = 36.0
    """Largest sum of squares of a fitted start that is kept."""

    steps: int = 8
    """Most steps of the fit of a start."""

    gain_left: float = 8.0
    """A start is given up if it would not be kept even after a gain of this many times that of its last step. It costs 4 % of the
    starts that would be kept, and 4.3 of 9 evaluations of a start remain."""

    apart_rad: float = 0.3
    """Of starts that are nearer to each other than this at all samples tried, one is kept."""

    most_cells: float = 8e6
    """Most cells times directions that are searched; beyond it the largest rate is reduced, and the verdict says so."""

    most_starts: float = 4e7
    """Cells times directions that take an hour: a largest rate of the caller that needs more is refused."""

    shared_edge: float = 0.5
    """Largest step of the grid over the largest rate if panels share inputs: three samples then fit motions all along a line of
    rates, and with one cell for all rates 1 of 8 true motions was lost."""

    choices: int = 40
    """Samples that are considered as the reference, evenly over those that are possible."""

    few: int = 5
    """Samples around the reference by which the time of a search is estimated."""

    speed_left: float = 0.3
    """Part of its speed that every wheel must still have at the reference, so that motions can be propagated back from there."""

    most_spun: float = 0.6
    """Most of the largest rate that wheels may transfer to the body until the reference. At 0.8 the grid has ten times the
    points."""

    faster_at_first: float = 1.05
    """Factor on the largest rate: a motion that began faster is left out."""

    spun_unsure: float = 0.15
    """Part of the rate transferred by the wheels that is allowed in addition: three sigmas of their friction."""

    start_cost: float = 5e-5
    """s of one core for a start. This and the next number only choose the reference."""

    window_cost: float = 3e-4
    """s of one core for a unit of the volume of rates that the first `few` samples allow."""


@dataclass(frozen=True)
class ShootingSettings:
    """How the motions of a lander are fitted, compared and kept while the window of samples grows."""

    held: int = 5
    """With fewer samples than this, inertia, friction and wheel are held at their centres: the samples do not determine them."""

    first_levels: tuple[tuple[float, int], ...] = ((3.0, 2), (1.0, 2))
    """Factors on the noise, each with a number of steps, of the fit to the first window. Wide noise attracts starts from afar."""

    levels: tuple[tuple[float, int], ...] = ((6.0, 3), (2.0, 3), (1.0, 3))
    """Factors and steps while the window grows. A motion may be off by `look_rad` at a new sample: under a narrower noise that
    reading counts as an outlier, and the fit ends in another minimum. From 3.0 on, 1 of 9 true motions at two minutes was lost."""

    again: tuple[tuple[float, int], ...] = ((1.0, 12),)
    """Factors and steps of another fit with new derivatives, if body and wheel are free. A motion moves along its valley farther
    than updated derivatives are valid. Without it 1 of 10 true motions at two minutes was lost."""

    last_levels: tuple[tuple[float, int], ...] = ((2.0, 3), (1.0, 8))
    """Factors and steps of the fit to all samples."""

    slack: float = 10.0
    """What one or two bad readings add to a true motion's misfit."""

    slack_held: float = 4.0
    """What fixed inertia, friction and wheel add to a true motion's misfit."""

    not_yet: float = 0.5
    """Excess misfit for each reading that is allowed after the steps under the wider noise."""

    noise_sigmas: float = 2.0
    """Sigmas of its prior by which the noise of a true motion may be larger than stated."""

    noise_most: float = 1.5
    """Largest logarithm of the noise over the stated one."""

    box_rad: float = 0.6
    """Motions that are nearer to each other than this at the end of the next window are copies, if `box_sun_rad` agrees."""

    box_sun_rad: float = 0.3
    """Largest distance of the Sun directions of copies at the reference: with few lit panels it is as uncertain as the rate."""

    ridge_chi2: float = 2.0
    """Squared distance in sigmas below which two motions lie on one ridge while the window grows, and are copies."""

    same_chi2: float = 9.0
    """Squared distance, in sigmas of either, below which two motions fitted to all samples are copies."""

    family_rad: float = 0.5
    """A motion whose uncertainty at the end of the next window exceeds this gets neighbours."""

    neighbour_rad: float = 0.65
    """Distance of these neighbours at that time."""

    family_directions: int = 3
    """Number of directions along which neighbours are placed: the least constrained ones."""

    valley_sigmas: float = 2.5
    """Along the least constrained direction a motion gets neighbours up to this many sigmas away, `neighbour_rad` apart."""

    valley_each: int = 12
    """Most of these neighbours on either side."""

    valley_motions: int = 50
    """Most motions of a window that get so many neighbours, the best ones."""

    valley_leading: float = 6.0
    """Their log probability is less than this below that of the best."""

    again_from: float = 1.35
    """Growth of the window's end after which a motion gets further neighbours."""

    grid_samples: int = 3
    """Up to this many samples starts are dense enough: neighbours are placed only if there are at most `few_starts` motions."""

    few_starts: int = 2000
    """See `grid_samples`."""

    look_rad: float = 0.6
    """Largest error of a motion at the sample added next, before it is fitted to it."""

    most_boxes: int = 100_000
    """Most motions kept before those on one ridge are joined."""

    most: int = 20_000
    """Most motions kept after that."""

    most_work: int = 200_000
    """Most motions times samples fitted to one window: a minute of one core."""

    most_search: int = 900_000
    """Most motions times samples fitted in a whole search. A window gets a third of what is left, but at least `least_work`."""

    least_work: int = 30_000
    """See `most_search`."""

    kept_anyway: int = 100
    """Motions kept if the readings rule out all, so that the verdict can say by how much."""

    drop: float = 30.0
    """Log probability below that of the best at which a motion is dropped; within a window `slack` is added."""

    most_fitted: int = 300
    """Most motions fitted to all samples that are kept."""

    torque_levels: tuple[int, ...] = (0, 2, 4)
    """Indices of the sizes of a constant torque, among its shares, under which fits begin."""

    searched_under: int = 1
    """Index of the size that a search under a torque assumes: smaller ones hold it near zero, the largest allows any motion."""


@dataclass(frozen=True)
class PosteriorSettings:
    """Everything that tunes `posterior`."""

    grid: GridSettings = GridSettings()
    shooting: ShootingSettings = ShootingSettings()
    search: SearchSettings = SearchSettings(growth=1.5, places=1, more_places=0)
    sampling: SamplingSettings = SAMPLING
    motions: float = 5e7
    """Computing budget in propagations over one interval between samples, about five minutes of one core: afterwards no step that
    can be left out is begun."""

    hopeless: float = 12.0
    """An alternative model is not sampled if its log evidence, by Laplace's method, is below the best by more than this."""

    others_draws: float = 0.5
    """Part of the draws that each model but the likeliest gets."""

    beyond: float = 2.0
    """Factor on the cost that a true motion does not exceed: beyond it nothing fits, and draws only say by how much."""

    beyond_draws: float = 0.1
    """Part of the draws, in two rounds, if nothing fits."""

    checked_draws: int = 400
    """Equally weighted draws by which the nominal model is judged before motions under torques are searched."""

    explains_p: float = 0.05
    """The nominal model explains the readings if simulated ones fit as badly with this probability,"""

    explains_noise: float = 2.0
    """the noise is within so many sigmas of its prior,"""

    explains_probability: float = 0.1
    """and its probability among the alternative models is at least this."""

    long_search: float = 400_000
    """Motions times samples of the search, two minutes of one core, beyond which none under torques follows: it takes four."""


POSTERIOR = PosteriorSettings()
"""What `posterior` uses by default."""
