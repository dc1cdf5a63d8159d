# Copyright 2026 gyro_drift_filter maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The verdict on a run of the filter over a recording: what it found, and whether it helped."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.core import Filter
from gyro_drift_filter.doctor.findings import Finding
from gyro_drift_filter.doctor.live_rules import RuleLog, is_truncation_refuted
from gyro_drift_filter.doctor.publishers import TakenTurns
from gyro_drift_filter.messages.imu import are_filtered
from gyro_drift_filter.messages.rules import Rule
from gyro_drift_filter.messages.span import Span
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.report.held_back import HeldBack
from gyro_drift_filter.report.run_sums import OUTLIER_STRETCH, add_run, end_run, no_sums
from gyro_drift_filter.report.sample_times import is_by_log, note_pace, sample_period
from gyro_drift_filter.version import package_version

# Fewer samples at rest do not tell what the noise is, nor fewer in motion what is changed there.
_FEWEST = 100
# Noise that falls by less than a tenth is not worth a filter.
_QUIETER = 0.9
# A bias within so many deviations of 0 on all three axes is none that was found.
SIGNIFICANT = 3.0
# The least and largest of many values of one bias lie up to so many deviations apart.
_RANGE = 6.0
# A filter that does not fit its sensor for more than this share of the time lags.
_LAGGING_SHARE = 0.1
# What is flagged because of spikes is a small share; many of them are motion or a false model.
_SPIKES = 0.1
# A filter that replaces so much of the motion loses about as much of each turn, which is five times
# what the scale of a good gyroscope is off.
_HELD_SHARE = 0.05


class Outcome(StrEnum):
    """What the filter did to the recording as a whole."""

    HELPED = 'helped'
    UNSURE = 'unsure'  # it subtracts a bias that may be nearer to the true one than 0, or not
    USELESS = 'useless'
    HARMED = 'harmed'


class BiasSource(StrEnum):
    """Where the bias comes from that the recording ends with."""

    REST = 'rest'
    PROVISIONAL = 'provisional'  # from what was not quite a rest, since the start
    MOTION = 'motion'  # from gravity, while the sensor moved: hardly about the vertical
    GIVEN = 'given'  # from the recording before
    UNKNOWN = 'unknown'


@dataclass(frozen=True)
class Rests:
    """How long the sensor was at rest, and its noise then.

    Attributes:
        count: Rests.
        seconds: All of them together.
        needed: For how long in whole s it had to stand still for the first one to be found.
        least: This time in s before it is rounded up.
        samples: At rest that the deviations are of: without the last second of each.
        raw_deviation: Standard deviation of the rates as they came, each rest about its own mean,
            (3,) in rad/s; NaN where it is not known.
        filtered_deviation: Standard deviation of the filtered rates, likewise, with what the mean
            of a rest is off by.
        ratio: The filtered one over the raw one, (3,).
    """

    count: int
    seconds: float
    needed: int
    least: float
    samples: int
    raw_deviation: Floats
    filtered_deviation: Floats
    ratio: Floats


@dataclass(frozen=True)
class Bias:
    """The bias at the end.

    Attributes:
        source: Where it comes from.
        rates: (3,) in rad/s.
        deviations: (3,) its standard deviation in rad/s, by the filter's own account.
        known_at: Log time since the first message in s from which on it was known; None where it
            was not learned at rest, or log times stand.
        taken_off: Whether it is taken off the rates.
        beyond_max: (3,) mean rates in rad/s where the sensor was as still as at rest, but at a rate
            beyond `bias.max`; NaN without such a time.
        moved: (3,) in rad/s how far its values at rest lay apart; 0 where its deviation at the
            first rest explains that.
    """

    source: BiasSource
    rates: Floats
    deviations: Floats
    known_at: float | None
    taken_off: bool
    beyond_max: Floats
    moved: Floats


@dataclass(frozen=True)
class Heading:
    """How the heading drifts by the bias, on the mean of the recording, in rad/s.

    Attributes:
        raw: With the raw rates: the mean of the bias about the vertical, as gravity shows it.
        left: Standard deviation of the drift with the filtered rates, and of `raw`, by the
            filter's own account of its bias since it was known.
        before: Turn in rad by the bias that was still in before it was known.
        turned: Sum of all turns about any axis in rad; errors of scale are a share of it.
        calibrated: Whether a matrix takes these off.
    """

    raw: float
    left: float
    before: float
    turned: float
    calibrated: bool


@dataclass(frozen=True)
class FlaggedOutliers:
    """Samples that were flagged as outliers; what was no usable number is none of them.

    Attributes:
        looked_for: Whether the parameters have the filter look for outliers.
        axes: How many on each axis (3,).
        at_rest: Samples with an outlier on some axis while at rest.
        in_motion: Samples with an outlier on some axis while in motion.
        first: When the first one came, in s of log time since the first message; None where none
            was flagged, or where log times stand.
        last: When the last one came, likewise.
        busiest: When the ten seconds with most of them began, likewise.
        in_busiest: How many came in these ten seconds.
        confirmed: How many were outliers, by what the samples behind them showed.
        knocks: How many were knocks by these, whose angle the filter gives back.
        motion: How many were motion by these, so that the filter starts anew behind them.
    """

    looked_for: bool
    axes: Integers
    at_rest: int
    in_motion: int
    first: float | None
    last: float | None
    busiest: float | None
    in_busiest: int
    confirmed: int
    knocks: int
    motion: int

    @property
    def samples(self) -> int:
        """How many samples had an outlier on some axis."""
        return self.at_rest + self.in_motion


@dataclass(frozen=True)
class Misfit:
    """How far the filter does not fit its sensor.

    Attributes:
        lagging: Share of the time in which innovations were far larger than the filter expects.
        held_back: Share of the motion that the filter took for outliers for longer than these last.
    """

    lagging: float
    held_back: float

    @property
    def lags(self) -> bool:
        """Whether the filter lags for so long that it does not fit its sensor."""
        return self.lagging > _LAGGING_SHARE

    @property
    def holds_motion_back(self) -> bool:
        """Whether the filter takes so much of the motion for outliers that turns are lost."""
        return self.held_back > _HELD_SHARE

    @property
    def harms(self) -> bool:
        """Whether the rates are worse with the filter than without."""
        return self.lags or self.holds_motion_back


@dataclass(frozen=True)
class Verdict:
    """What a run of the filter was good for.

    Attributes:
        topic: The Imu topic.
        output_topic: The filtered one.
        method: Of the filter.
        version: Of this package.
        outcome: Whether it helped.
        gains: What it did for the recording, of 'noise', 'bias', 'outliers'.
        received: Imu messages read.
        written: Of them filtered or passed on.
        not_reported: Of them passed on, as they state no rate.
        seconds: From the first message of the recording to the last, in log time.
        sampled_seconds: Of that what the samples stand for: a pause without messages is no time in
            which a sensor could stand still.
        period: Of the samples in s; by the log times where stamps are 0 or stand.
        rests: The rests.
        bias: The bias.
        heading: The drift of the heading.
        outliers: Those that were flagged.
        change_in_motion: Root mean square (3,) in rad/s of what the filter changes in motion beside
            the bias; NaN without enough motion.
        silent: Why an axis has no figures (3,); empty where it has.
        lagging: As in `Misfit`.
        held_back: As in `Misfit`.
        findings: What in the recording is unsound.
    """

    topic: str
    output_topic: str
    method: str
    version: str
    outcome: Outcome
    gains: list[str]
    received: int
    written: int
    not_reported: int
    seconds: float
    sampled_seconds: float
    period: float
    rests: Rests
    bias: Bias
    heading: Heading
    outliers: FlaggedOutliers
    change_in_motion: Floats
    silent: list[str]
    lagging: float
    held_back: float
    findings: list[Finding]

    @property
    def misfit(self) -> Misfit:
        """How far the filter does not fit its sensor."""
        return Misfit(self.lagging, self.held_back)


class RunWatch:
    """Sees what goes through a filter, and sums it up; its memory does not grow with the run."""

    def __init__(self, filter_: Filter) -> None:
        """Start with a filter that has seen nothing yet."""
        self._filter = filter_
        self._matrix = np.array(filter_.parameters.calibration_matrix, np.float64)
        self._given = False
        self._sums = no_sums()
        self._rules = RuleLog()
        self._turns = TakenTurns()
        # Samples, not seconds: a gap without messages is no time of which anything is said.
        self._reported = self._lagging = 0
        self._held_back = HeldBack()
        # Of the bias, while it is not known and while it is: samples, and the sum of its variance
        # over them on each axis in (rad/s)^2.
        self._variances = np.zeros((2, 4))
        # At rest: the least and largest bias, and the deviation of the first one, (3,) in rad/s.
        self._at_rest: tuple[Floats, Floats, Floats] | None = None

    def take(self, imus: Any, log_times: Integers) -> None:
        """See messages (n,) IMU that were filtered, with their log times (n,) in ns."""
        if self._sums[0]['samples'] == 0:
            self._note_given(imus)
        note_pace(self._sums['times'], self._filter)
        add_run(imus, np.ascontiguousarray(log_times, np.int64), self._matrix, self._sums)
        self._held_back.take(imus, self.period)
        self._rules.take(imus, log_times)
        self._turns.take(imus['sample']['angular_velocity'])

    @property
    def is_by_log(self) -> bool:
        """Whether it is log times that tell the time, as stamps are 0 or stand."""
        return is_by_log(self._sums['times'])

    @property
    def period(self) -> float:
        """Time between samples in s; by the log times where it is they that tell the time."""
        return sample_period(self._sums['times'], self._filter)

    def _seconds_needed(self) -> float:
        """Return for how long in s the sensor had to stand still to be found at rest."""
        needed = float(self._filter.record['coefficients']['rest']['least_rest'][0])
        if self.is_by_log:
            # The filter counts samples, and takes them to be as far apart as it assumes.
            needed *= self.period / float(self._filter.state['clock']['period'])
        return needed

    def _note_given(self, imus: Any) -> None:
        """Note whether the first sample has a bias taken off that the recording before has left."""
        results = imus['result'][are_filtered(imus)]
        if len(results) and self._filter.parameters.bias_enabled:
            initial = self._filter.parameters.bias_initial
            self._given = bool((results['bias'][0] != initial).any())
            self._sums['known'] = self._given

    def judge(self, span: Span, rules: Sequence[Rule], seconds: float) -> None:
        """See which rules apply to a report, so many s after the one before."""
        self._rules.judge(span, rules, seconds)
        self._reported += span.samples
        if any(rule.name == 'large innovations' for rule in rules):
            self._lagging += span.samples
        state = span.now.telemetry
        if state.at_rest and state.segments > 0:
            bias, known = np.array(state.bias), np.array(state.bias_deviation)
            least, largest, deviation = self._at_rest or (bias, bias, known)
            self._at_rest = np.minimum(least, bias), np.maximum(largest, bias), deviation
        squares = np.square([1.0, *state.bias_deviation])
        self._variances[int(state.bias_known)] += span.samples * squares

    def verdict(self, summary: Summary) -> Verdict:
        """Return the verdict at the end of the run."""
        sums = self._sums.copy()
        end_run(sums)
        filter_, total = self._filter, sums[0]
        rests = _rests(total, self._seconds_needed())
        bias = self._bias(total, summary)
        heading = self._heading(total, bias)
        outliers = _flagged_outliers(
            total['outliers'], summary, looked_for=filter_.parameters.outlier_enabled
        )
        moving = int(total['moving'])
        misfit = self._misfit(moving + outliers.in_motion)
        faults = self._faults(misfit)
        gains = _gains(rests, bias, outliers, summary)
        if in_degrees(faults):
            # What is flagged there is motion, 57 times as fast as it is.
            gains = [gain for gain in gains if gain != 'outliers']
        silent = [_why_silent(total, summary, axis) for axis in range(3)]
        has_rates = not (all(silent) or in_degrees(faults))
        return Verdict(
            topic=summary.topic,
            output_topic=summary.output_topic,
            method=filter_.parameters.method,
            version=package_version(),
            outcome=_outcome(misfit, gains, is_unsure=has_rates and _is_unsure(bias)),
            gains=gains,
            received=summary.received,
            written=summary.written,
            not_reported=summary.not_reported,
            # Log times may stand, as where a converter has filled them in.
            seconds=max(summary.seconds, float(total['seconds'])),
            sampled_seconds=float(total['seconds']),
            period=self.period,
            rests=rests,
            bias=bias,
            heading=heading,
            outliers=outliers,
            change_in_motion=(
                np.sqrt(total['changed'] / moving) if moving >= _FEWEST else np.full(3, np.nan)
            ),
            silent=silent,
            lagging=misfit.lagging,
            held_back=misfit.held_back,
            findings=faults,
        )

    def _misfit(self, in_motion: int) -> Misfit:
        """Return how far the filter does not fit, of so many samples in motion."""
        lagging = self._lagging / self._reported if self._reported else 0.0
        held_back = int(self._held_back.samples.max()) / in_motion if in_motion >= _FEWEST else 0.0
        return Misfit(lagging, held_back)

    def _faults(self, misfit: Misfit) -> list[Finding]:
        # Of a filter that does not follow the motion, what it takes for outliers says nothing of
        # the recording. Gravity is held against the rates that stand in for these.
        refuted = {'outliers', 'diverged'} if misfit.harms else set()
        if misfit.holds_motion_back:
            refuted.add('contradicts gravity')
        truncation_refuted = is_truncation_refuted(self._filter)
        found = self._rules.findings(refuted, truncation_refuted=truncation_refuted)
        return [finding for finding in found if finding.is_fault] + self._turns.faults()

    def _bias(self, total: Any, summary: Summary) -> Bias:
        filter_ = self._filter
        state = filter_.state['bias']
        source = BiasSource.UNKNOWN
        if state['segments'] > 0:
            source = BiasSource.REST
        elif state['provisional_variance'][0] > 0.0 and state['bias'].any():
            source = BiasSource.PROVISIONAL
        elif state['corrected'] > 0:
            source = BiasSource.MOTION
        elif self._given:
            source = BiasSource.GIVEN
        return Bias(
            source,
            state['bias'].copy(),
            summary.bias_deviation,
            _since_start(int(total['rested_at']), summary) if total['rests'] else None,
            filter_.parameters.bias_enabled,
            self._rules.rates.mean('beyond bias.max'),
            self._moved(),
        )

    def _moved(self) -> Floats:
        """Return how far the bias moved between the rests, as in `Bias`."""
        if self._at_rest is None:
            return np.zeros(3)
        least, largest, deviation = self._at_rest
        return np.where(largest - least > _RANGE * deviation, largest - least, 0.0)

    def _heading(self, total: Any, bias: Bias) -> Heading:
        seconds = float(total['seconds'])
        calibrated = self._filter.parameters.is_calibrated
        if seconds == 0.0:
            return Heading(0.0, float('nan'), 0.0, 0.0, calibrated)
        before = 0.0
        if not bias.taken_off:
            turn = float(total['up_seconds'] @ bias.rates)
        else:
            turn = float(total['taken'])
            if total['known'] and not self._given:
                # The bias of the first rest was there before, too.
                before = float(total['up_before'] @ total['first_bias'] - total['taken_before'])
                turn += before
        variance = np.square(bias.deviations)
        # What a bias that was not known yet has turned is `before`, unless none was ever known.
        samples, *variances = self._variances[int(self._variances[1, 0] > 0.0)]
        if samples > 0.0:
            variance = np.array(variances) / samples
        left = float(np.sqrt(total['up_squares'] @ variance / seconds))
        return Heading(turn / seconds, left, before, float(total['turned']), calibrated)


def in_degrees(findings: Sequence[Finding]) -> bool:
    """Return whether the rates seem to be in degrees per second."""
    return any(finding.name in ('degrees', 'noise in degrees') for finding in findings)


def _rests(total: Any, needed: float) -> Rests:
    noise, unknown = total['noise'], np.full(3, np.nan)
    raw, filtered = unknown, unknown
    samples, means = int(noise['count']), int(total['noise_rests'])
    if samples >= _FEWEST and samples > means:
        variance = noise['raw_squares'] / (samples - means)
        # A smoothed rate wanders so slowly that much of its noise may be in the mean of a rest. As
        # smoothing leaves means as they are, the error of this mean is that of n raw samples: n
        # squares of it sum up to one variance of these.
        filtered = np.sqrt((noise['filtered_squares'] + means * variance) / samples)
        raw = np.sqrt(variance)
    ratio = np.divide(filtered, raw, out=unknown.copy(), where=raw > 0.0)
    return Rests(
        int(total['rests']),
        float(total['rest_seconds']),
        math.ceil(needed),
        needed,
        samples,
        raw,
        filtered,
        ratio,
    )


def _since_start(log_time: int, summary: Summary) -> float | None:
    """Return a log time in s since the first message; None where log times stand."""
    return 1e-9 * (log_time - summary.start) if summary.seconds > 0.0 else None


def _flagged_outliers(found: Any, summary: Summary, *, looked_for: bool) -> FlaggedOutliers:
    axes = found['axes'].copy()
    at_rest, in_motion = int(found['at_rest']), int(found['in_motion'])
    if at_rest + in_motion == 0:
        return FlaggedOutliers(looked_for, axes, 0, 0, None, None, None, 0, 0, 0, 0)
    first, last = (_since_start(int(found[name]), summary) for name in ('first', 'last'))
    busiest = None if first is None else first + 1e-9 * OUTLIER_STRETCH * int(found['busiest'])
    return FlaggedOutliers(
        looked_for,
        axes,
        at_rest,
        in_motion,
        first,
        last,
        busiest,
        int(found['in_busiest']),
        int(found['were_outliers']),
        int(found['were_knocks']),
        int(found['were_motion']),
    )


def _gains(rests: Rests, bias: Bias, outliers: FlaggedOutliers, summary: Summary) -> list[str]:
    """Return what the filter did for the recording."""
    gains = []
    if np.isfinite(rests.ratio).any() and np.nanmedian(rests.ratio) < _QUIETER:
        gains.append('noise')
    is_found = bias.source != BiasSource.UNKNOWN and bias.taken_off
    if is_found and bool(np.any(np.abs(bias.rates) > SIGNIFICANT * bias.deviations)):
        gains.append('bias')
    if outliers.confirmed and int(outliers.axes.max()) < _SPIKES * summary.received:
        gains.append('outliers')
    return gains


def _outcome(misfit: Misfit, gains: Sequence[str], *, is_unsure: bool) -> Outcome:
    if misfit.harms:
        return Outcome.HARMED
    if gains:
        return Outcome.HELPED
    return Outcome.UNSURE if is_unsure else Outcome.USELESS


def _is_unsure(bias: Bias) -> bool:
    """Return whether a bias is taken off that no rest of this recording has shown."""
    unsure = (BiasSource.PROVISIONAL, BiasSource.MOTION, BiasSource.GIVEN)
    return bias.taken_off and bias.source in unsure and bool(bias.rates.any())


def _why_silent(total: Any, summary: Summary, axis: int) -> str:
    """Return in words why an axis has no figures; empty where it has."""
    samples, value = int(total['samples']), float(total['least'][axis])
    if samples == 0:
        if summary.unusable[axis] > 0:
            return 'no usable rate'
        return 'not reported' if summary.not_reported else 'no figures'
    if samples > 1 and value == total['largest'][axis]:
        return f'dead, always {np.degrees(value) + 0.0:.4f}'  # 0, not -0
    return ''
