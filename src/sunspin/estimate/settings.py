"""All numbers that tune the estimation: with unit, meaning, and what set them.

Rules of the verdict stand in :mod:`sunspin.estimate.verdict`: they are not tuned, they are the error rates. What concerns the
accuracy of a computation alone stands where it is computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class PassSettings:
    """How samples are parted into passes, and which of a pass the search keeps."""

    gap_intervals: float = 6.0
    """A gap parts two passes if it is longer than so many usual intervals."""

    longest_s: float = 3000.0
    """Longer passes are cut: over half an orbit the wandering of a rate is still small against a turn."""

    longest_field_s: float = 1000.0
    """The same if a magnetometer is read. Without an orbit, the field turns ever faster or slower for a sixth of one at most: over
    half an orbit rates of simulated spinners were off by 0.03 deg/s at a stated sigma of 0.014."""

    many: int = 500
    """With an orbit passes are that short only if they would have more samples: kept samples 70 s apart, four turns at 21 deg/s,
    left two of four undecided. Slow bodies, read every 10 s, need the longer pass."""

    longest_dark_s: float = 300.0
    """A pass does not end if panels show no Sun for less than this and a magnetometer is read. The shadow of the Earth lasts
    longer. A body with one panel that turned once in 28 s had a pass for each turn."""

    kept: int = 40
    """Samples of a pass that the search keeps, at most."""

    growth: float = 1.4
    """Ratio of neighbouring intervals of the kept samples. They begin with the intervals of the file and widen to even ones, so
    that the rate known from some samples always predicts the next one."""

    dense: int = 12
    """Samples among which a search finds its first pairs: a pass that begins in the dark is searched where so many see the Sun."""


@dataclass(frozen=True)
class SearchSettings:
    """How motions are found: where starts are placed, how the window grows, and which candidates are dropped."""

    noise: float = 1e-4
    """rad/s^1.5; unknown torques under which motions are searched, however quiet the body may be: stiffer motions creep."""

    basin_rad: float = 0.35
    """A start that is nearer to the truth than this, as a turn at the samples of its window, ends in it."""

    step_rad: float = 0.35
    """Spacing of the turns, as vectors, that are tried between two directions of the Sun. No turn is farther than half a basin."""

    most_starts: int = 200_000
    """Starts of one pair of samples; a grid of rates becomes coarser to hold to it."""

    most_turns: int = 100
    """Whole turns between two samples, at most: where both hardly bound the Sun, more would make millions of starts."""

    least_drift_rad: float = 5e-3
    """A body that turns by less than this in the error of a sample's time is taken for read at exact times: it is half of the
    usual error of a direction."""

    large_drift_rad: float = 0.03
    """With more than this motions are searched again under the errors of the times."""

    around: int = 2
    """Samples on either side of the first pair on which its starts are tried."""

    crowd: int = 3000
    """With more starts than this, they are tried on the pair alone first, and on four samples."""

    tried: tuple[int, int, int] = (6_000, 1500, 120)
    """Starts that are kept by the pair alone, by four samples, and by the first window."""

    growth: float = 1.33
    """Factor by which the number of samples in the window grows. A rate from a window predicts the phase one window further."""

    most: int = 32
    """Candidates kept while the window grows. Those that fall by this number do not make a search incomplete."""

    drop: float = 18.0
    """Candidates are dropped that are less probable than the best by exp(-18)."""

    drop_if_rounded: float = 9.0
    """Factor of `drop` if times were rounded, while their errors are not known: these make the others three times as large."""

    copies_rad: float = 0.25
    """Copies turn alike between neighbouring samples to this: half the least distance of two mirror images."""

    copies_sigmas: float = 3.0
    """Candidates within so many of their own sigmas of each other lie in one valley, and are copies too."""

    valley_sigmas: float = 2.5
    """How far along the weakly constrained direction of the rate further candidates are placed. One beyond costs 3 more."""

    valley_each: int = 8
    """Further candidates on either side of one, at most."""

    valley_most: int = 16
    """Further candidates for one window, at most: with 64 no more of 100 slow bodies were found."""

    valley_fits: float = 0.4
    """Candidates that cost more than this share of the limit get no further ones: they do not fit."""

    valley_leading: float = 6.0
    """Candidates that cost more than the best by this get no further ones."""

    places: int = 3
    """Pairs of samples to start from, unless one is enough (:func:`sunspin.estimate.starts.pairs_to_try`)."""

    places_if_flat: int = 4
    """The same if panels lie in one plane or share inputs, and bound the Sun so little."""

    flat_budget: float = 2.0
    """Times the usual computing budget for such panels: more pairs, and each motion has its mirror image. With a magnetometer
    a search of 40 samples takes 1.2 to 1.6 times the usual one; cut short, two such spinners were not decided."""

    more_places: int = 2
    """Further pairs to start from if the best candidate does not fit."""

    good_enough: float = 0.8
    """A candidate fits for the search if it costs less than this share of the limit."""

    watch: Callable[[Any, Any], None] | None = None
    """Called with each window and its candidates: to see which stage dropped a motion."""


@dataclass(frozen=True)
class LadderSettings:
    """Strengths of unknown torques, a rung each, that are equally likely before the data."""

    rungs: tuple[float, ...] = (5e-6, 2e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
    """rad/s^1.5; at 3e-4 a rate wanders by 0.3 deg/s in five minutes. Below the lowest the evidence is rounding."""

    strong: float = 1e-3
    """Rung under which an inertia that is wrong finds its place."""

    strained: float = 3e-4
    """Rung from which a body of which only the Sun is measured is searched again under `strong`, though its motion fits. Without an
    inertia a body at 12.5 deg/s, sampled every 30 s, was decided as one at 0.2 deg/s; with one that was a sigma off, a long body
    was decided 13 sigma off."""

    cooling: float = 5.5
    """Largest ratio of two neighbouring strengths: a motion that is stiffened more at once stays where it is."""

    steps: int = 8
    """Steps of a fit on a rung that begins where the one before ended."""

    first_steps: int = 20
    """Steps of the fit on the first rung."""

    tolerance: float = 1e-3
    """Predicted gain in cost below which a fit ends: 0.045 sigma. With a tenth of it fits of few samples take 1.4 times the steps,
    as many of them overshoot. No evidence changes by more than 0.012."""

    creeping: float = 1.0
    """A motion whose cost rises by more than this from one rung to the next may only creep: it is fitted further by steps along the
    equations of motion. Fitting all motions so took twice the time of passes with few samples."""

    stiff_rad: float = 0.1
    """Torques are weak for such a fit if they turn the body by less than this in half of the pass."""

    hopeless: float = 18.0
    """Log evidence by which a motion, or a rung, is too improbable to go on with."""

    beyond_fit: float = 3.0
    """Sizes of a torque that are larger than the fitted one by this factor get nothing: there the answer is not linear."""

    common: float = 0.75
    """Share of the prior of the rungs that comes from the other passes of the file."""


@dataclass(frozen=True)
class AlternativeSettings:
    """Other models of a pass."""

    hopeless: float = 6.0
    """Log evidence by which an alternative may be worse than the best model and is followed: beyond it counts for 0.2 %."""

    doubted: float = 1.0
    """If a magnetometer that is not calibrated raises the log evidence by this, the search is made again without believing it."""

    most_steps: int = 4
    """Steps of the rate in a pass, at most."""

    step_sizes: float = float(np.log(np.log(100.0)))
    """What it costs in log evidence that the size of a step is known to a factor of a hundred only, and put where it comes out."""

    torque_turns_rad: tuple[float, ...] = tuple(np.radians(np.geomspace(1.0, 300.0, 6)).tolist())
    """Turns of the body over a pass by a constant torque: one sigma each, equally likely. It is not known to a power of ten."""

    tilt_shows: float = 2.0
    """Half the square of residuals that two angles of one panel take away, from which misaligned panels are tried. In 18 right
    passes it was 0.0 to 1.8, with panels misaligned by 3 degrees 2.4 and more. The evidence decides; this saves time."""

    zero_odds: float = float(np.log(0.05 / 0.95))
    """Log odds that the zero of a gyro is off by more than the vehicle file states."""

    swings_rad: tuple[float, ...] = (0.15, 0.3, 0.6, 1.2)
    """Turns of a swinging body about each axis between two samples, one sigma each; each is another model."""

    even_rad: float = 0.5
    """Samples are even if whole turns between the closest two are whole turns between all others, to this."""

    momentum_off_rad: float = 0.35
    """Revolutions about two axes are tried if the angular momentum of the new rates is nearer than this to its place in space. In a
    pass that was decided as an alias without them it is 0.1."""

    beyond: float = 2.0
    """Times the largest rate up to which a fast body without an inertia is searched if nobody stated that rate, and up to 1 rad/s.
    The prior of the rate stays as it is, so that a faster motion must fit better. With an inertia such a search takes as long as
    all the rest, and of 6 passes it changed one, for the better."""


@dataclass(frozen=True)
class SolutionSettings:
    """Which motions under several models are one solution, and which are reported."""

    counted: float = 0.01
    """Motions of a model with less than this part of the largest probability are left out."""

    bent_rad: float = 1.0
    """Two models bend one motion apart by so much between two samples at most; others differ by more, mostly by whole turns."""

    most: int = 6
    """Solutions reported for each pass."""

    least: float = 1e-3
    """Solutions of less probability are not reported."""

    slower: tuple[float, ...] = tuple(np.geomspace(1.0, 1 / 30, 6).tolist())
    """Parts of the largest rate up to which a body may turn, equally likely, if a rate may be of any size."""

    named: float = 0.05
    """Another model is named if the nominal one has less probability."""


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
    """How the posterior about fitted motions is drawn."""

    rounds: int = 16
    """Rounds of draws, at most."""

    soft_rad: float = 0.25
    """A direction of rate and Sun with a larger sigma, as a turn within the window while the unknowns are held, is weakly
    constrained. Philae's second one has 0.08 (5.3 if the unknowns vary): as an outer coordinate it left 45 draws of 16,000."""

    most_softs: int = 2
    """Weakly constrained directions, at most."""

    trace: int = 180
    """Points at each width from which the curve of a ridge is learnt: four for each term of the regression of a lander. With 100
    the log evidence of a curved ridge was short by 0.1 instead of 0.03, though Philae's draws were as good."""

    trace_small: int = 70
    """The same of a ridge with less probability than `small` of the likeliest, by Laplace's method."""

    trace_widths: tuple[float, ...] = (0.3, 0.7, 1.3)
    """How far about its motion a ridge is followed, in sigmas of Laplace's method, one after the other."""

    small: float = 0.01
    """Part of the likeliest ridge's probability."""

    draws: int = 1000
    """Draws of each round, of all ridges together. With 2000 the first law, of whose draws one in twelve counts, proposes twice as
    many."""

    block: int = 500
    """Draws that are settled together: their derivatives are kept in memory."""

    wanted: float = 1000.0
    """Effective draws with which sampling ends; 700 make a verdict sure. They leave the log evidence uncertain by 0.03."""

    good_tail: float = 0.5
    """Pareto index k with which it ends; up to 0.55 a verdict is sure."""

    freedom: float = 5.0
    """Degrees of freedom of the Student laws: heavier than the tails of a posterior with a few unknowns."""

    widened: float = 1.3
    """Factor on the covariances of Laplace's method in the first round."""

    inner_width: float = 1.1
    """Factor on the sigmas of the stiff coordinates given the others."""

    reading_draws: int = 8
    """Sets of gains, brightness and misalignments that are drawn for each motion. With one, a set far out in its law once left 416
    effective draws of 16,000."""

    reading_step: float = 2.0
    """Longest step to their best values, in sigmas of the prior."""

    defence: float = 0.15
    """Part of the outer law that stays with Laplace's method, with twice its covariance."""

    least: float = 5e-5
    """Probability, relative to the likeliest, below which a ridge is left out. Solutions are listed down to twice this."""

    most_ridges: int = 60
    """Ridges that are drawn, at most."""

    on_ridge: float = 9.0
    """Squared distance for each coordinate, in sigmas, within which a fitted motion lies on the ridge of another."""

    far_torque: float = 3.0
    """Times a share of its sigma beyond which linear theory of a torque is not believed."""

    points_per_term: float = 1.5
    """Draws for each term of a regression, at least."""

    thin: float = 0.75
    """A combination of outer coordinates is thin if it has less than this part of the sigma that it had if they were independent.
    It then follows the others by a quadratic. Two minutes apart, friction and moments of Philae have two such, of 0.02 and 0.03:
    609 effective draws of 16,000 without the quadratic, 3,295 of 12,000 with it."""

    straight: float = 0.9
    """Part of its sigma that the quadratic must leave at most, or the combination stays straight."""

    draws_per_term: float = 3.0
    """Effective draws for each term of that quadratic, at least."""

    off_ridge: float = 6.0
    """Draws farther from the regression than this many times the median are left out of it."""

    connected: float = 0.02
    """Ridges that share this part of the posterior of one of them are one region."""

    no_weight: float = 1e-5
    """A model with less probability is left out."""

    one_region: float = 9.0
    """Squared distance, in sigmas of the wider, below which regions under two models are one."""

    bent_rad: float = 1.0
    """rad by which two models may bend one motion apart within the window; others differ by whole turns."""

    sun_rad: float = 0.3
    """The same of the direction at the reference."""

    checked: int = 100
    """Draws for which readings are simulated."""

    copies: int = 10
    """Sets of readings that are simulated of each."""

    cold_runs: float = 12.0
    """Runs of a motion that a draw of the first round takes, for the computing budget."""

    warm_runs: float = 3.0
    """The same of later rounds."""


SAMPLING = SamplingSettings()
"""How draws are made by default."""


@dataclass(frozen=True)
class OrbitSettings:
    """How an orbit is compared with telemetry. The first six are the error rates of the verdict."""

    copies: int = 50
    """Comparison orbits of random node and phase."""

    better: int = 1
    """Comparison orbits that may fit better: right elements are refused once in 50 times at most."""

    times: float = 1.3
    """Elements are refused if another node makes the residuals smaller by this factor. On skCUBE, whose plane is known, some
    nodes do by 1.05: a sensor's own errors."""

    mistaken: float = 0.2
    """If more comparison orbits than this are expected to win by chance against right elements, the data cannot rank."""

    clearly: float = 12.0
    """Log likelihood by which another clock, or a field of the opposite sign, must fit better to be named."""

    mirrored: float = 0.5
    """A field of the wrong sign is named if, reversed, its angle to the Sun is off by less than this share."""

    nodes_deg: tuple[float, ...] = (-24.0, -12.0, -6.0, -3.0, 3.0, 6.0, 12.0, 24.0)
    """Other nodes that are tried, relative to that of the elements."""

    hours: tuple[int, ...] = (*range(-12, 0), *range(1, 15))
    """Errors of a clock that are tried: those of time zones."""

    samples: int = 200
    """Samples of the file that are compared."""

    span: float = 3.0
    """The along-track offset is sought within so many of its sigmas."""

    step_s: float = 20.0
    """Steps of the offset, s; they are wider if `most_steps` do not cover the span."""

    most_steps: int = 37
    """Offsets that are tried, at most."""

    near: float = 60.0
    """A comparison orbit is fitted at a third of the offsets, and at all if its cost comes so near to the one that counts."""

    most_scatter: tuple[float, float] = (0.1, 3.0)
    """Noise that is believed where no orbit fits: of the strength, over the field, and of the Sun, in its sigmas."""

    fine: int = 33
    """Steps among which the offset is estimated."""

    deep: float = 10.0
    """They cover all offsets whose cost is at most so much above the least: every minimum counts."""

    blocks: int = 8
    """Parts of the file that are left out in turn for the sigma of the offset."""

    around: int = 9
    """Offsets that are tried for each of them, within three sigmas."""

    few: float = 1.15
    """Factor by which a sigma from so few parts is too small for 90 % to lie within 1.645 of it: Student's law, 7 degrees of
    freedom."""


ORBIT = OrbitSettings()
"""What the check of an orbit uses by default."""


# What is believed before the data, about satellites.

INERTIA = 0.01
"""Relative sigma of each moment if the vehicle file states none, and that of each product in units of the mean moment: known
exactly, they would make any answer too sure."""

UNKNOWN_MOMENT, UNKNOWN_PRODUCT = 0.3, 0.1
"""The same, of the mean moment, without an inertia: a 3U CubeSat's moments are 0.7 below and 0.4 above their mean."""

UNKNOWN_SHARES = (1.0, 0.4)
"""Parts of these sigmas, equally likely: for long bodies, and for 1U CubeSats, whose moments differ by 5 to 10 %. An alias that
turns slower needs a body farther from a sphere. With the wide sigmas alone a wrong alias was decided in 6 of 13 sparse passes of
fast bodies without an inertia, with both in 3; of 61 other cases none changed its outcome."""

INERTIA_SIGMAS = 4.0
"""No trial inertia or gain is farther from the vehicle file than this, in its sigmas."""

LARGEST_RATE = 1.0
"""rad/s; the search goes no farther unless asked: every sixth of a turn more is another start."""

LARGEST_TURNS = 1.5
"""Nor farther than so many turns in the shorter intervals."""

GYRO_ZEROS = tuple(np.radians([3.0, 0.95, 0.3, 0.095, 0.03, 0.003]).tolist())
"""rad/s by which the zero of a gyro may be off if the vehicle file states no sigma: equally likely; the last means not at all."""

FIELD_TURN = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field turn at about twice its own rate of 1.1e-3 rad/s."""

EARTH_WIDER, EARTH_ZERO, EARTH_KNOWN = 1.5, 0.3, 0.25
"""Relative to what panels that face away from the Sun read on average: prior sigma of the Earth's light as a vector, and of what a
panel reads too much all the time. Last, the part of the light that an orbit leaves open in direction and change: clouds and coasts
are where they are."""

DIPOLE_SIZES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
"""rad/s2; sigmas of the acceleration by an unknown magnetic dipole, equally likely: 0.005 A m2 on a 1U CubeSat make the first."""


# What is believed before the data, about a lander.

LANDER_LARGEST_RATE = 0.6
"""rad/s: the ball of rates that is searched unless the vehicle file or the caller says otherwise."""

WHEEL_SPEED, FRICTION = 0.005, 0.05
"""Relative sigmas of a wheel's speed and friction if the vehicle file states none: known exactly, they would make any answer too
sure."""

BRIGHTNESS_KNOWN, BRIGHTNESS_FREE = 0.06, 1.0
"""Sigma of the logarithm of the brightness if gains have a unit (cell temperature, distance) and if they are relative."""

NOISE_STATED, NOISE_UNSTATED = 0.3, 1.0
"""Sigma of the logarithm of the noise about what the vehicle states, and about what is assumed if it states none."""

LOOSER_INERTIA, LOOSER_CHANCE = 5.0, 0.05
"""How many times less certain the moments of inertia may be than stated, and how likely that is before the data."""

TORQUE_TURNS_DEG = (1.0, 300.0, 6)
"""Least and largest turn of the body over the samples by an unknown constant torque, and how many sizes, equally likely, stand for
all: it is not known to a power of ten."""

OUTLIER, OUTLIER_DARK, OUTLIER_LARGEST = 0.02, 0.5, 1.5
"""Probability that a reading of a lander's panels is an outlier, one that has nothing to do with the Sun; that an outlier is dark;
and the upper limit of a lit outlier, over the largest reading, below which all values are equally likely."""


@dataclass(frozen=True)
class GridSettings:
    """Where the motions of a lander are looked for: the reference, a grid of rates there, and what settles between its points."""

    turn_rad: float = 1.6
    """Turn by which neighbours of the grid differ at the farthest sample that is tried; interpolated attitudes then err by 0.05."""

    amplified: float = 1.15
    """Turn in rad per rad/s and s: what the nutation by a wheel or uneven moments adds."""

    between_rad: float = 0.08
    """By how much nine of ten attitudes half way between runs of the grid may err; elsewhere they err half as much, less than by
    interpolation in a cell. For Philae runs are three steps apart, one for 27 points of the grid."""

    near_rad: float = 0.35
    """What a point stands for: points are a quarter of a cell's edge apart."""

    far_rad: float = 0.65
    """The same for the middle of an eighth of a cell."""

    node_rad: float = 0.03
    """How far any direction is from its node, on a cube of `nodes` cells along an edge, by which readings are compared with it."""

    nodes: int = 48
    """Cells along an edge of the cube of nodes."""

    brightness: float = 0.08
    """Relative error of brightness and gains while starts are looked for."""

    sigmas: float = 3.0
    """A reading counts against a point beyond so many sigmas, by the square of what is left."""

    cap: float = 16.0
    """Largest square of one reading: it may be an outlier."""

    largest_misfit: float = 1e6
    """Largest square of one reading while the points of an eighth are compared with each other."""

    limit: float = 20.0
    """A point falls if readings of one sample contradict it by this."""

    directions: int = 3000
    """Directions on the sphere, 3.7 degrees apart, of which those that the reference sample allows are starts."""

    directions_rad: float = 0.3
    """Starts stand for directions as near as this."""

    blur_rad: float = 0.07
    """Error of interpolated attitudes and of the brightness, added to the noise while starts settle."""

    settled: float = 36.0
    """Sum of squares up to which a settled start is kept."""

    steps: int = 8
    """Steps by which a start settles, at most."""

    gain_left: float = 8.0
    """Times what the last step has gained that all steps to come may gain: starts that cannot settle so are left. It costs 4 % of
    those that would, and leaves 4.3 of 9 evaluations of a start."""

    apart_rad: float = 0.3
    """At the samples tried: of starts nearer to each other one is kept."""

    most_cells: float = 8e6
    """Cells times directions that are looked through, at most: else the ball of rates is made smaller, and the verdict says so."""

    most_starts: float = 4e7
    """Cells times directions for which an hour is needed: a largest rate of the caller that asks for more is refused."""

    shared_edge: float = 0.5
    """Step of the grid over the largest rate, at most, if panels share inputs: three samples then fit motions all along a line of
    rates, and with one cell for the whole ball 1 of 8 true motions was lost."""

    choices: int = 40
    """Samples that are considered as the reference, evenly over those that may be it."""

    few: int = 5
    """Samples around the reference by which the length of a search is estimated."""

    speed_left: float = 0.3
    """Part of its speed that every wheel has left at the reference, so that motions can be followed back through it."""

    most_spun: float = 0.6
    """Of the largest rate, what wheels may have handed over until the reference. At 0.8 the grid has ten times as many points."""

    faster_at_first: float = 1.05
    """Times the largest rate beyond which a motion cannot have begun."""

    spun_unsure: float = 0.15
    """Part of what wheels hand over that is allowed in addition: three sigmas of their friction."""

    start_cost: float = 5e-5
    """s of one core for a start; with the next number it chooses the reference, which is all that depends on it."""

    window_cost: float = 3e-4
    """s of one core for a unit of the volume of rates that the first `few` samples allow."""


@dataclass(frozen=True)
class ShootingSettings:
    """How the motions of a lander are fitted, compared and carried on."""

    held: int = 5
    """With fewer samples than this inertia, friction and wheel are held at their centres: few samples determine none of them."""

    first_levels: tuple[tuple[float, int], ...] = ((3.0, 2), (1.0, 2))
    """Factor on the noise, and steps, one after the other: of the fit to the first window. Wide noise draws in what is far."""

    levels: tuple[tuple[float, int], ...] = ((6.0, 3), (2.0, 3), (1.0, 3))
    """The same while the window grows. A motion may be off by `look_rad` at the sample that is new: under a narrower noise that
    reading counts as an outlier, and the fit ends in another minimum. From 3.0 on, 1 of 9 true motions at two minutes was lost."""

    again: tuple[tuple[float, int], ...] = ((1.0, 12),)
    """Again with new derivatives, if body and wheel are free: derivatives corrected by steps do not carry as far as
    a motion then moves along its valley. Without it 1 of 10 true motions at two minutes was lost."""

    last_levels: tuple[tuple[float, int], ...] = ((2.0, 3), (1.0, 8))
    """The same on all samples."""

    slack: float = 10.0
    """What one or two bad readings add to a true motion's misfit."""

    slack_held: float = 4.0
    """What fixed inertia, friction and wheel add to it."""

    not_yet: float = 0.5
    """What a motion may be worse by, for each reading, after the steps under the wider noise."""

    noise_sigmas: float = 2.0
    """Sigmas of its prior by which the noise of a true motion may be larger than stated."""

    noise_most: float = 1.5
    """Logarithm of the noise over the stated one, at most."""

    box_rad: float = 0.6
    """At the end of the next window: motions nearer to each other are copies."""

    box_sun_rad: float = 0.3
    """The same of the direction at the reference: where few panels are lit it is as uncertain as the rate."""

    ridge_chi2: float = 2.0
    """Squared distance in sigmas below which two motions lie on one ridge while the window grows, and are copies."""

    same_chi2: float = 9.0
    """The same, in sigmas of either, of motions fitted to all samples."""

    family_rad: float = 0.5
    """A motion that is free by more than this at the end of the next window is one of a family, and gets neighbours."""

    neighbour_rad: float = 0.65
    """How far away these are, at that time."""

    family_directions: int = 3
    """Directions along which neighbours are set: the loosest."""

    again_from: float = 1.35
    """Growth of the window's end after which a motion gets further neighbours."""

    grid_samples: int = 3
    """Samples for which starts lie dense enough: there neighbours are set only if there are at most `few_starts` motions."""

    few_starts: int = 2000
    """See `grid_samples`."""

    look_rad: float = 0.6
    """By how much a motion may be wrong about the sample added next, before it is fitted to it."""

    most_boxes: int = 100_000
    """Motions carried on, at most, before those on one ridge are joined."""

    most: int = 20_000
    """The same after that."""

    most_work: int = 200_000
    """Motions times samples fitted to one window, at most: a minute of one core."""

    most_search: int = 900_000
    """The same of a whole search; a window gets a third of what is left, and `least_work` in any case: every search ends."""

    least_work: int = 30_000
    """See `most_search`."""

    kept_anyway: int = 100
    """Motions carried on where the readings rule out all, so that the verdict can say by how much."""

    drop: float = 30.0
    """Log weight below the best at which a motion is left out."""

    most_fitted: int = 300
    """Motions fitted to all samples that are kept, at most."""

    torque_levels: tuple[int, ...] = (0, 2, 4)
    """Which sizes of a constant torque, of its shares, fits begin under."""

    searched_under: int = 1
    """Size that a search under a torque assumes: smaller ones hold it where it does not act, the largest lets all motions pass."""


@dataclass(frozen=True)
class PosteriorSettings:
    """Everything that tunes `posterior`."""

    grid: GridSettings = GridSettings()
    shooting: ShootingSettings = ShootingSettings()
    search: SearchSettings = SearchSettings(growth=1.5, places=1, more_places=0)
    sampling: SamplingSettings = SAMPLING
    motions: float = 5e7
    """Motions carried over one interval between two samples, after which nothing that can be left out is begun: about five minutes
    of one core."""

    hopeless: float = 12.0
    """Log evidence below the best, by Laplace's method, at which an alternative model is not sampled."""

    others_draws: float = 0.5
    """Part of the draws for each model but the likeliest one."""

    beyond: float = 2.0
    """Times the cost that a true motion does not exceed: beyond it nothing fits, and draws only say by how much."""

    beyond_draws: float = 0.1
    """Part of the draws then, in two rounds."""

    checked_draws: int = 400
    """Draws of equal weight by which the nominal model is judged before motions under torques are searched for."""

    explains_p: float = 0.05
    """The nominal model explains the readings if simulated ones fit as badly with this probability,"""

    explains_noise: float = 2.0
    """the noise is within so many sigmas of its prior,"""

    explains_probability: float = 0.1
    """and alternative models leave it this probability."""

    long_search: float = 400_000
    """Motions times samples fitted, two minutes of one core, beyond which no search under torques follows: it takes four."""


POSTERIOR = PosteriorSettings()
"""What `posterior` uses by default."""
