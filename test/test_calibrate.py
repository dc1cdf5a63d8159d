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

"""Scale and misalignment from turns by hand: against simulated sensors, and one that is real."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.calibrate import CalibrationError, turning
from gyro_drift_filter.calibrate.calibration import Samples, calibrate
from gyro_drift_filter.calibrate.rests import find_rests
from gyro_drift_filter.calibrate.track import make_track
from gyro_drift_filter.calibrate.turning import (
    Leg,
    integrals,
    rotations,
    step_vectors,
    turn,
    turn_alone,
)
from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides
from support.messages import even_stamps
from support.paths import RECORDINGS, recorded

UP = Rotation.identity()
DEGREE = np.radians(1.0)


def samples(turns, change=None):
    arrays = turns.stamps, turns.rates.copy(), turns.accelerations.copy()
    if change is not None:
        change(*arrays)
    return Samples(*arrays)


def about(axis, degrees):
    return Rotation.from_rotvec(np.radians(degrees) * np.eye(3)['xyz'.index(axis)])


def laid_down(random, poses=None, **options):
    faults = random_faults(random)
    return faults, lay_down(random, sides(random) if poses is None else poses, faults, **options)


@pytest.mark.slow
def test_intervals_hold_and_entries_are_near(random):
    errors, deviations, accelerometer = [], [], []
    for _ in range(5):
        faults, turns = laid_down(random, rate=50.0)
        found = calibrate([samples(turns)])
        assert not found.unknown
        assert not found.warnings
        assert found.sides == 12
        errors.append(found.matrix - faults.matrix)
        deviations.append(found.deviation)
        of = found.accelerometer
        accelerometer.append((of.bias - faults.accelerometer_bias) / of.bias_deviation)
        upper = np.triu_indices(3)
        wrong = (of.matrix - faults.accelerometer)[upper]
        accelerometer.append(wrong / of.matrix_deviation[upper])
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.deviation.ravel())
    assert np.abs(errors).mean(axis=0).max() < 5e-4
    scores = np.divide(errors, deviations)
    assert 0.8 < np.sqrt(np.mean(scores**2)) < 1.25
    assert np.abs(scores).max() < 4.5
    assert 0.7 < np.sqrt(np.mean(np.concatenate(accelerometer) ** 2)) < 1.4


@pytest.mark.slow
def test_a_nominal_scale_that_is_far_off_is_no_harm(random):
    faults, turns = laid_down(random, rate=50.0)
    for factor in (0.6, 1.0, 1.6):
        found = calibrate([samples(turns, lambda _, w, a, f=factor: np.divide(w, f, out=w))])
        np.testing.assert_allclose(found.matrix, factor * faults.matrix, atol=1.5e-3)
        np.testing.assert_allclose(found.after.angles, 0.0, atol=0.2 * DEGREE)


@pytest.mark.slow
def test_several_recordings_each_with_its_own_bias(random):
    faults, first = laid_down(
        random, [about('x', turned) for turned in (0, 90, 175, 260)], rate=50.0
    )
    poses = [about('x', 90), about('x', 90) * about('y', 120), about('z', 90) * about('x', 40)]
    moved = replace(faults, bias=-faults.bias, wander=0.0)
    second = lay_down(random, poses, moved, rate=50.0)
    both = calibrate([samples(first), samples(second)])
    alone = calibrate([samples(first)])
    assert both.deviation.sum() < 0.7 * alone.deviation.sum()
    assert (np.abs(both.matrix - faults.matrix) < 4.0 * both.deviation).all()
    assert set(both.legs[:, 0]) == {0.0, 1.0}


def test_one_pose_is_told(random):
    _, turns = laid_down(random, [UP], rest=10.0)
    with pytest.raises(CalibrationError, match='was not turned: there is one rest only'):
        calibrate([samples(turns)])


@pytest.mark.parametrize('count', [12, 24])
def test_a_recording_that_is_shorter_than_a_rest_can_be_is_told(count, random):
    _, turns = laid_down(random, rate=100.0)
    arrays = turns.stamps[:count], turns.rates[:count], turns.accelerations[:count]
    with pytest.raises(CalibrationError, match=f'its {count} samples last for 0.*too short'):
        calibrate([Samples(*arrays)])


def test_rests_of_few_samples_have_a_duration(random):
    """One that lasts for long is cut into pieces; at a low rate some of these were empty."""
    _, turns = laid_down(random, rate=50.0)
    track = make_track(1000 * turns.stamps, turns.rates, turns.accelerations)
    rests = find_rests(track).rests
    assert len(rests) > 10
    assert min(rest.seconds for rest in rests) > 0.0


def test_without_a_rest_there_is_nothing(random):
    _, turns = laid_down(random, rest=0.3)
    with pytest.raises(CalibrationError, match='no rest found: lay the sensor down'):
        calibrate([samples(turns)])


@pytest.mark.parametrize(
    'poses',
    [[UP, UP, UP], [UP, about('x', 90)], [about('z', heading) for heading in (0, 90, 180, 270)]],
    ids=['one pose again and again', 'two poses', 'one side, turned on the table'],
)
def test_a_recording_that_tells_nothing_is_no_calibration(poses, random):
    """The first gave half the scale, as gravity closes turns that lead nowhere with any."""
    _, turns = laid_down(random, poses, rate=50.0)
    with pytest.raises(CalibrationError, match='no entry is known twice as well as from a data'):
        calibrate([samples(turns)])


def test_turns_that_are_all_too_fast_are_told(random):
    _, turns = laid_down(random, rate=50.0)
    with pytest.raises(CalibrationError, match='at the end of its range are left out, so turn it'):
        calibrate([samples(turns, lambda _, w, a: np.clip(w, -0.6, 0.6, out=w))])


def test_too_few_poses_are_told_and_not_taken_for_an_axis_that_was_not_turned(random):
    faces = [UP, about('x', 90), about('x', 180), about('y', 90), about('x', -90), about('y', -90)]
    turned = [
        about('z', heading) * face for heading, face in zip(range(0, 300, 50), faces, strict=True)
    ]
    faults, turns = laid_down(random, turned, rate=50.0)
    found = calibrate([samples(turns)])
    (text,) = found.unknown
    assert text.startswith('lay it down in more poses, best in the twelve poses of docs/')
    assert 'the scale of z is known to' in text
    assert (np.abs(found.matrix - faults.matrix) < 4.0 * found.deviation).all()


@pytest.mark.slow
def test_a_sensor_that_is_held_is_told(random):
    faults, turns = laid_down(random)
    each = 0.02 * random.standard_normal((12, 3))  # a degree on the way to each pose

    def held(stamps, rates, accelerations):
        for k, step in enumerate(each):
            rates[400 + 650 * k : 650 + 650 * k] += step / 2.5

    found = calibrate([samples(turns, held)])
    assert any('lay it on something firm, and let go of it: ' in text for text in found.unknown)
    assert (np.abs(found.matrix - faults.matrix) < 4.0 * found.deviation).all()


def test_what_was_not_turned_is_told_and_stays_as_it_is(random):
    faults, turns = laid_down(random, [about('x', 90 * k) for k in range(5)], rate=50.0)
    found = calibrate([samples(turns)])
    assert any('turn it about y, too' in text for text in found.unknown), found.unknown
    assert (np.abs(found.matrix - faults.matrix) < 4.0 * found.deviation).all()
    scales = np.diag(found.deviation)
    assert scales[0] < 2e-3
    assert scales[1:].min() > 5e-3


def test_without_an_accelerometer_it_says_what_else_will_do(random):
    _, turns = laid_down(random, rate=50.0)
    for nothing in (0.0, np.nan):
        with pytest.raises(CalibrationError, match='no acceleration in the recording'):
            calibrate([samples(turns, lambda _, w, a, v=nothing: a.fill(v))])


@pytest.mark.slow
def test_a_rest_that_moves_is_left_out_and_told(random):
    faults, turns = laid_down(random)

    def turning(stamps, rates, accelerations):
        """Put the third rest on a table that turns: two degrees a second about the vertical."""
        rates[1350:1650] += 2.0 * DEGREE * accelerations[1350:1650] / 9.8

    def sinking(stamps, rates, accelerations):
        """Have the third rest tilt by a degree, evenly."""
        tilt = np.linspace(0.0, 1.0, 450) * DEGREE * 9.8
        accelerations[1275:1725] += tilt[:, None] * [1.0, -1.0, 1.0]

    for change in (turning, sinking):
        found = calibrate([samples(turns, change)])
        assert any('the sensor moved in what looked like rest' in text for text in found.warnings)
        assert (np.abs(found.matrix - faults.matrix) < 4.5 * found.deviation).all()
        assert np.abs(found.matrix - faults.matrix).max() < 3e-3


@pytest.mark.slow
def test_a_turn_that_does_not_fit_counts_for_less(random):
    faults, turns = laid_down(random)

    def knocked(stamps, rates, accelerations):
        rates[1070, 1] += 8.0  # 5 degrees

    found = calibrate([samples(turns, knocked)])
    assert any('do not fit the others' in text for text in found.warnings)
    assert np.abs(found.matrix - faults.matrix).max() < 2e-3


@pytest.mark.slow
def test_gaps_and_the_end_of_the_range_break_a_turn(random):
    faults, turns = laid_down(random)
    lost = np.ones(len(turns.stamps), bool)
    lost[1070:1100] = False
    cut = Samples(turns.stamps[lost], turns.rates[lost], turns.accelerations[lost])
    end = np.quantile(np.abs(turns.rates), 0.99)
    clipped = samples(turns, lambda _, w, a: np.clip(w, -end, end, out=w))
    for recording, message in ((cut, 'turns with a gap'), (clipped, 'turn it more slowly: at')):
        found = calibrate([recording])
        assert any(message in text for text in found.warnings)
        assert np.abs(found.matrix - faults.matrix).max() < 5e-3


def test_a_pause_of_the_recorder_is_no_part_of_the_sample_period(random):
    """Else blocks hold fewer samples, and what is short of a rest is one."""
    _, turns = laid_down(random)
    found = []
    for pause in (0, 600 * 10**9):
        stamps = turns.stamps + pause * (np.arange(len(turns.stamps)) > len(turns.stamps) // 2)
        track = make_track(stamps, turns.rates, turns.accelerations)
        found.append((track, find_rests(track)))
    (track, before), (paused, after) = found
    assert paused.period == pytest.approx(track.period)
    np.testing.assert_allclose(after.rate_density, before.rate_density, rtol=0.05)
    assert len(before.rests) <= len(after.rests) <= len(before.rests) + 1


def set_back(seconds):
    """Return a change that sets the clock of the stamps back from half of the recording on."""

    def change(stamps, rates, accelerations):
        stamps[len(stamps) // 2 :] -= round(seconds * 1e9)

    return change


@pytest.mark.slow
@pytest.mark.parametrize('even', [True, False], ids=['even', 'of arrival'])
@pytest.mark.parametrize('seconds', [3600.0, 5.0, 0.3])
def test_what_is_behind_a_clock_that_was_set_back_counts(seconds, even, random):
    """It was dropped up to the old time, and the turns over what was dropped were too short."""
    faults, turns = laid_down(random, rate=100.0)
    middle = float(turns.stamps[len(turns.stamps) // 2] - turns.stamps[0]) * 1e-9
    step = set_back(seconds)

    def change(*arrays):
        if not even:
            burst(*arrays)
        step(*arrays)

    found = calibrate([samples(turns, change)])
    told = [text for text in found.warnings if 'the clock of the stamps was set back by' in text]
    assert len(told) == 1
    when = float(told[0].split(' s at ')[1].split(' s after')[0])
    assert when == pytest.approx(middle, abs=0.2)
    assert found.sides == 12
    assert np.abs(found.matrix - faults.matrix).max() < 2e-3


def test_what_is_late_or_repeated_is_no_clock_that_was_set_back(random):
    _, turns = laid_down(random, [UP, about('x', 90)], rate=100.0)
    stamps, n = turns.stamps, len(turns.stamps)
    every = np.arange(n)
    # Two that change places; ten that are held back for longer than they last; a copy of each
    # message a tenth of a second later; one that is late by seconds.
    swapped, held = every.copy(), every.copy()
    swapped[100:n:50] -= 1
    swapped[99 : n - 1 : 50] += 1
    held[500:530] = np.concatenate([every[510:530], every[500:510]])
    copies = np.stack([every[10:], every[:-10]], axis=1).ravel()
    late = np.insert(np.delete(every, 300), 700, 300)
    for order in (swapped, held, copies, late):
        track = make_track(stamps[order], turns.rates[order], turns.accelerations[order])
        assert not track.set_back
        # Of what changes places, the latest counts.
        assert len(track.seconds) >= n - 11 - n // 50


def test_stamps_that_are_uneven_by_many_periods_are_no_clock_that_was_set_back(random):
    """At 1 kHz 276 steps of a minute were told, and the minute became 62 s."""
    stamps = even_stamps(60_000, 1000) + (3e6 * random.standard_normal(60_000)).astype(np.int64)
    rates, accelerations = random.standard_normal((2, 60_000, 3))
    track = make_track(stamps, rates, accelerations)
    assert len(track.set_back) <= 10
    assert track.seconds[-1] == pytest.approx(60.0, abs=0.1)


def test_a_single_stamp_of_the_future_does_not_hide_what_follows(random):
    _, turns = laid_down(random, [UP, about('x', 90)], rate=100.0)
    stamps = turns.stamps.copy()
    stamps[len(stamps) // 2] += 3600 * 10**9
    track = make_track(stamps, turns.rates, turns.accelerations)
    assert len(track.seconds) == len(stamps)
    assert track.broken.sum() == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (
            lambda _, w, a: w.__setitem__((slice(None), 1), -w[:, 1]),
            'no calibration fits the turns: ',
        ),
        (lambda _, w, a: np.degrees(w, out=w), 'are they in deg/s'),
        (
            lambda _, w, a: np.divide(a, 9.8, out=a),
            'the acceleration at rest is 0.994 where gravity',
        ),
        (lambda s, w, a: s.fill(0), 'are the stamps zero'),
        (lambda s, w, a: w.fill(np.nan), 'samples can be used: no rate is a number'),
        (lambda s, w, a: w[:, 1].fill(np.nan), 'samples can be used: no rate about y is a number'),
    ],
)
def test_other_faults_than_scale_are_no_calibration(change, message, random):
    _, turns = laid_down(random, rate=50.0)
    with pytest.raises(CalibrationError, match=message):
        calibrate([samples(turns, change)])


@pytest.mark.slow
def test_a_robot_that_drives_is_told_to_lay_the_sensor_down(random):
    """Its motors shake the rates, so turns did not close; it was asked for a wrong sign."""
    moving = np.arange(6000) % 1200 >= 200
    rates, accelerations = 2e-3 * random.standard_normal((2, 6000, 3))
    accelerations[:, 2] += 9.8
    rates[moving] += 0.1 * random.standard_normal((moving.sum(), 3))
    accelerations[moving] += 0.3 * random.standard_normal((moving.sum(), 3))
    driven = Samples(even_stamps(6000, 50), rates, accelerations)
    tried = []
    with pytest.raises(CalibrationError, match='on one side, as those of a robot'):
        calibrate([driven], progress=lambda done, total: tried.append(done))
    assert len(tried) < 40  # 15 scales, and one round for a matrix that vanishes


def burst(stamps, rates, accelerations):
    """Have the driver stamp five samples as they arrive together."""
    stamps[:] = stamps[np.minimum(np.arange(len(stamps)) // 5 * 5 + 4, len(stamps) - 1)]
    stamps += 1000 * np.arange(len(stamps))


@pytest.mark.slow
def test_stamps_of_arrival_are_not_taken_for_the_time_of_samples(random):
    faults, turns = laid_down(random)
    found = calibrate([samples(turns, burst)])
    assert 'the stamps are those of arrival: samples are taken as evenly spaced' in found.warnings
    assert np.abs(found.matrix - faults.matrix).max() < 2e-3


@pytest.mark.slow
def test_samples_without_a_rate_do_not_make_even_stamps_uneven(random):
    faults, turns = laid_down(random)

    def lose(stamps, rates, accelerations):
        rates[::10] = np.nan

    found = calibrate([samples(turns, lose)])
    assert not any('arrival' in warning for warning in found.warnings)
    assert np.abs(found.matrix - faults.matrix).max() < 2e-3


def test_a_warning_does_not_stand_for_the_error(random):
    """Of one rest with stamps of arrival it said only how these are taken."""
    turns = lay_down(random, sides(random)[:1], random_faults(random), rate=50.0)
    with pytest.raises(CalibrationError, match='the sensor was not turned') as error:
        calibrate([samples(turns, burst)])
    assert 'arrival' not in str(error.value)


def test_a_turn_and_what_it_depends_on(random):
    time = np.arange(301) * 0.01
    raw = np.column_stack([2 * np.sin(1.3 * time), 1.5 * np.cos(2 * time), 1 + np.sin(3 * time)])
    steps = np.full(300, 0.01)
    share = np.linspace(0.0, 1.0, 300)
    leg = Leg(0, (0, 1), 0.0, 3.0, steps, *integrals(raw, steps), share, np.zeros(3))
    matrix = np.eye(3) + 0.03 * random.standard_normal((3, 3))
    way, sensitivity = turn(leg, matrix)
    whole = Rotation.identity()
    mean = 0.5 * (raw[1:] + raw[:-1]) @ matrix.T
    for rate in mean:
        whole = whole * Rotation.from_rotvec(0.01 * rate)
    np.testing.assert_allclose(way.rotation, whole.as_matrix(), atol=1e-4)
    np.testing.assert_allclose(turn_alone(leg, matrix).rotation, way.rotation, atol=1e-12)
    before, _ = rotations(step_vectors(*integrals(raw, steps), matrix))
    np.testing.assert_allclose(np.linalg.norm(before, axis=1), 1.0)
    for entry in range(9):
        changed = matrix.copy()
        changed.ravel()[entry] += 1e-5
        step = Rotation.from_matrix(turn_alone(leg, changed).rotation @ way.rotation.T).as_rotvec()
        np.testing.assert_allclose(step / 1e-5, sensitivity.by_matrix[:, entry], atol=3e-4)


def test_samples_faster_than_a_hand_moves_are_taken_together(random, monkeypatch):
    """A recording of half an hour at 1000 Hz took many minutes, for nothing."""
    _, turns = laid_down(random, [UP, about('x', 90)], rate=1000.0)
    track = make_track(turns.stamps, turns.rates, turns.accelerations)
    ends = find_rests(track).rests
    legs = []
    for seconds in (turning.STEP_SECONDS, 0.0):
        monkeypatch.setattr(turning, 'STEP_SECONDS', seconds)
        legs.append(turning.make_leg(track, 0, (0, 1), ends, 1e-4 * np.eye(3)))
    together, single = legs
    assert len(together.steps) < 0.11 * len(single.steps)
    matrix = np.eye(3) + 0.03 * random.standard_normal((3, 3))
    (way, by), (finest, by_finest) = (turn(leg, matrix) for leg in legs)
    np.testing.assert_allclose(way.rotation, finest.rotation, atol=1e-8)
    assert way.angle == pytest.approx(finest.angle, rel=1e-3)
    np.testing.assert_allclose(by.by_matrix, by_finest.by_matrix, atol=1e-4)
    np.testing.assert_allclose(by.by_biases, by_finest.by_biases, atol=1e-4)


@pytest.mark.slow
def test_a_real_sensor_closes_turns_that_it_was_not_found_from():
    """An Xsens whose nominal scale is 31 % off, laid down by hand 38 times."""
    data = read_imu_arrays(recorded(RECORDINGS / 'multiposition_xsens'))
    first = (data.stamps - data.stamps[0]) < 260e9
    parts = [
        Samples(data.stamps[part], data.angular_velocity[part], data.linear_acceleration[part])
        for part in (first, ~first)
    ]
    found, other = (calibrate([part]) for part in parts)
    np.testing.assert_allclose(np.diag(found.matrix), [1.309, 1.315, 1.312], atol=3e-3)
    assert found.matrix[1, 2] == pytest.approx(-0.069, abs=4e-3)
    scores = (found.matrix - other.matrix) / np.hypot(found.deviation, other.deviation)
    assert np.abs(scores).max() < 3.0
    assert np.degrees(np.sqrt(np.mean(found.after.angles**2))) < 0.2
    assert np.degrees(np.sqrt(np.mean(found.before.angles**2))) > 20.0
