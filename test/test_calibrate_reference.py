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

"""Scale and misalignment from turns that a reference has seen, or that led back to an edge."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.bags.orientations import read_orientations
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.calibrate import CalibrationError, turning
from gyro_drift_filter.calibrate import reference as reference_module
from gyro_drift_filter.calibrate.calibration import Samples, calibrate
from gyro_drift_filter.calibrate.reference import Mount, Reference, ReferenceOfOneRecording
from gyro_drift_filter.calibrate.track import make_track
from gyro_drift_filter.calibrate.unknowns import MATRIX, start
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides
from support.bags import write

DEGREE = np.radians(1.0)
MOUNT = Rotation.from_rotvec(20.0 * DEGREE * np.array([0.6, -0.64, 0.48]))
LATE = 0.04  # s


def seen(random, turns, mount=MOUNT, noise=0.3, late=LATE, every=1):
    """Return what a camera has seen of a body that the sensor is fixed to."""
    jitter = Rotation.from_rotvec(noise * DEGREE * random.standard_normal((len(turns.stamps), 3)))
    orientations = Rotation.from_quat(turns.orientations) * mount * jitter
    stamps = turns.stamps + round(late * 1e9)
    return Reference(stamps[::every], orientations.as_quat()[::every])


@pytest.mark.slow
def test_rotation_and_delay_are_found_on_the_way(random):
    faults = random_faults(random)
    turns = lay_down(random, sides(random), faults)
    reference = seen(random, turns, every=2)
    found = calibrate([Samples(turns.stamps, turns.rates, turns.accelerations, reference)])
    assert np.abs(found.matrix - faults.matrix).max() < 5e-4
    fit = found.reference
    off = (Rotation.from_quat(fit.rotation) * MOUNT.inv()).as_rotvec()
    assert np.linalg.norm(off) < 0.1 * DEGREE
    assert (np.abs(off) < 4.0 * fit.rotation_deviation).all()
    assert fit.late == pytest.approx(LATE, abs=2e-3)
    assert abs(fit.late - LATE) < 4.0 * fit.late_deviation
    assert fit.noise == pytest.approx(0.3 * DEGREE, rel=0.05)
    assert not fit.level


@pytest.mark.slow
def test_samples_faster_than_a_hand_moves_are_taken_together(random, monkeypatch):
    """At 1000 Hz most of the time was that of samples between which nothing is asked for."""
    turns = lay_down(random, sides(random)[:2], random_faults(random), rate=1000.0)
    track = make_track(turns.stamps, turns.rates, turns.accelerations)
    orientations = seen(random, turns, every=20)
    unknowns = start()
    unknowns[MATRIX] += 0.03 * random.standard_normal(9)
    counts, found = [], []
    for seconds in (turning.STEP_SECONDS, 0.0):
        monkeypatch.setattr(turning, 'STEP_SECONDS', seconds)
        steps = []

        def counted(vectors, steps=steps):
            steps.append(len(vectors))
            return turning.rotations(vectors)

        monkeypatch.setattr(reference_module, 'rotations', counted)
        part = ReferenceOfOneRecording(0, track, orientations, np.full(3, 1e-8))
        part.divide(Mount(MOUNT.as_quat()), LATE)
        found.append(part.residuals(unknowns))
        counts.append(sum(steps))
    assert counts[0] < 0.11 * counts[1]
    together, single = found
    np.testing.assert_allclose(together.values, single.values, atol=1e-4)
    scale = np.abs(single.jacobian).max()
    np.testing.assert_allclose(together.jacobian, single.jacobian, atol=2e-3 * scale)


@pytest.mark.slow
def test_a_reference_alone_leaves_the_sensor_its_axes(random):
    faults = random_faults(random)
    turns = lay_down(random, sides(random), faults, rest=0.5, rate=50.0)
    nothing = np.full_like(turns.accelerations, np.nan)
    reference = seen(random, turns, late=-0.1)
    found = calibrate([Samples(turns.stamps, turns.rates, nothing, reference)])
    assert found.accelerometer is None
    np.testing.assert_allclose(found.matrix, found.matrix.T, atol=1e-4)
    # The same but for a rotation of all, which the mount has taken.
    left, stretch, right = np.linalg.svd(faults.matrix @ np.linalg.inv(found.matrix))
    np.testing.assert_allclose(stretch, 1.0, atol=2e-3)
    off = Rotation.from_matrix(left @ right) * Rotation.from_quat(found.reference.rotation)
    assert (off * MOUNT.inv()).magnitude() < 0.2 * DEGREE
    assert found.reference.late == pytest.approx(-0.1, abs=2e-3)


def test_a_reference_is_not_compared_across_a_clock_that_was_set_back(random):
    turns = lay_down(random, sides(random)[:2], random_faults(random))
    stamps, reference = turns.stamps.copy(), seen(random, turns)
    for clock in (stamps, reference.stamps):
        clock[len(clock) // 2 :] -= 5 * 10**9
    with pytest.raises(CalibrationError, match=r'set back by 5\.00 s at .* with --start or --end'):
        calibrate([Samples(stamps, turns.rates, turns.accelerations, reference)])


@pytest.mark.slow
def test_slips_and_losses_of_a_reference_do_not_count(random):
    faults = random_faults(random)
    turns = lay_down(random, sides(random), faults, rate=50.0)
    reference = seen(random, turns, noise=0.1)
    reference.orientations[1000:1010] = [0.0, 0.0, 0.0, 1.0]
    reference.orientations[2000:2050] = np.nan
    reference.orientations[3000] = 0.0
    found = calibrate([Samples(turns.stamps, turns.rates, turns.accelerations, reference)])
    assert np.abs(found.matrix - faults.matrix).max() < 1e-3
    assert found.reference.noise == pytest.approx(0.1 * DEGREE, rel=0.1)


@pytest.mark.slow
def test_wheels_tell_the_scale_about_the_vertical_alone(random):
    faults = random_faults(random)
    poses = [
        Rotation.from_rotvec([0.0, 0.0, angle]) for angle in np.cumsum(random.uniform(-3, 3, 9))
    ]
    ways = [[0.0, 0.0, (b * a.inv()).as_rotvec()[2]] for a, b in pairwise(poses)]
    turns = lay_down(random, poses, faults, turns=ways, wobble=0.0, rate=50.0)
    reference = seen(random, turns, mount=Rotation.identity(), noise=0.0)
    yaw = Rotation.from_quat(reference.orientations).as_rotvec()[:, 2:]
    yaw = yaw + 0.2 * DEGREE * random.standard_normal(yaw.shape)
    level = Reference(reference.stamps, Rotation.from_rotvec(yaw * [0.0, 0.0, 1.0]).as_quat())
    found = calibrate([Samples(turns.stamps, turns.rates, turns.accelerations, level)])
    assert found.reference.level
    # By gravity alone it stays unknown; what the sensor calls vertical is known to its own bias.
    assert found.matrix[2, 2] == pytest.approx(faults.matrix[2, 2], abs=4.0 * found.deviation[2, 2])
    assert found.deviation[2, 2] < 5e-3
    assert any('the scale of x is known' in text for text in found.unknown)
    with pytest.raises(CalibrationError, match='the recording tells too little'):
        calibrate([Samples(turns.stamps, turns.rates, turns.accelerations)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda s, q: s.__iadd__(10**12), 'overlap by too little: are their stamps of one clock'),
        (lambda s, q: q.__setitem__(slice(None), q[0]), 'the reference hardly turns'),
        (
            lambda s, q: q.__setitem__(slice(None), q[::-1].copy()),
            'do not turn alike|no calibration fits',
        ),
        (lambda s, q: q.fill(np.nan), 'only 0 orientations'),
    ],
)
def test_a_reference_that_does_not_fit_is_told(change, message, random):
    turns = lay_down(random, sides(random)[:5], random_faults(random), rate=50.0)
    reference = seen(random, turns)
    change(reference.stamps, reference.orientations)
    with pytest.raises(CalibrationError, match=message):
        calibrate([Samples(turns.stamps, turns.rates, turns.accelerations, reference)])


def whole_turns(random, faults, accelerometer=True):
    """Return a case that is turned about each of its axes, twice and back, against an edge."""
    upright = Rotation.identity()
    on_sides = (upright, 2), (about([np.pi / 2, 0, 0]), 1), (about([0, -np.pi / 2, 0]), 0)
    poses, ways = [], []
    for side, axis in on_sides:
        headings = random.normal(0.0, 0.3, 4) * DEGREE
        if poses:
            ways.append((poses[-1].inv() * about([0, 0, headings[0]]) * side).as_rotvec())
        poses += [about([0, 0, heading]) * side for heading in headings]
        for sign, step in zip((1, -1, 1), np.diff(headings), strict=True):
            ways.append((4.0 * np.pi * sign + step) * np.eye(3)[axis])
    turns = lay_down(random, poses, faults, turns=ways, way=6.0, wobble=0.0, rate=50.0)
    accelerations = turns.accelerations if accelerometer else np.zeros_like(turns.accelerations)
    return Samples(turns.stamps, turns.rates, accelerations)


def about(vector):
    return Rotation.from_rotvec(vector)


@pytest.mark.slow
def test_whole_turns_against_an_edge(random):
    faults = random_faults(random)
    recording = whole_turns(random, faults)
    by_gravity, found = (calibrate([recording], turns=turns) for turns in (False, True))
    assert (np.abs(found.matrix - faults.matrix) < 4.0 * found.deviation).all()
    assert np.diag(found.deviation).max() < 1.5e-3
    assert np.diag(by_gravity.deviation).max() > 1.5 * np.diag(found.deviation).max()


@pytest.mark.slow
def test_whole_turns_without_an_accelerometer(random):
    faults = random_faults(random)
    found = calibrate([whole_turns(random, faults, accelerometer=False)], turns=True)
    assert (np.abs(found.matrix - faults.matrix) < 4.0 * found.deviation).all()
    assert np.diag(found.deviation).max() < 1.5e-3
    assert found.accelerometer is None
    assert found.sides == 0


def stamped(kind, place, stamp, quaternion):
    """Return a message of a type with an orientation at a place."""
    kinds = {
        'header': message_type('std_msgs/msg/Header')(
            message_type('builtin_interfaces/msg/Time')(stamp // 10**9, stamp % 10**9), 'world'
        )
    }
    value = message_type('geometry_msgs/msg/Quaternion')(*quaternion)
    point = message_type('geometry_msgs/msg/Point')(0.0, 0.0, 0.0)
    vector = message_type('geometry_msgs/msg/Vector3')(0.0, 0.0, 0.0)
    header, nothing = kinds['header'], np.zeros(36)
    pose = message_type('geometry_msgs/msg/Pose')(point, value)
    with_covariance = message_type('geometry_msgs/msg/PoseWithCovariance')(pose, nothing)
    twist = message_type('geometry_msgs/msg/TwistWithCovariance')(
        message_type('geometry_msgs/msg/Twist')(vector, vector), nothing
    )
    parts = {
        'PoseStamped': (header, pose),
        'PoseWithCovarianceStamped': (header, with_covariance),
        'TransformStamped': (
            header,
            'body',
            message_type('geometry_msgs/msg/Transform')(vector, value),
        ),
        'QuaternionStamped': (header, value),
        'Odometry': (header, 'body', with_covariance, twist),
        'Imu': (header, value, np.zeros(9), vector, np.zeros(9), vector, np.zeros(9)),
    }[kind.rpartition('/')[2]]
    return serialize(message_type(kind)(*parts), kind)


@pytest.mark.slow
@pytest.mark.parametrize(
    'kind',
    [
        'geometry_msgs/msg/PoseStamped',
        'geometry_msgs/msg/PoseWithCovarianceStamped',
        'geometry_msgs/msg/TransformStamped',
        'geometry_msgs/msg/QuaternionStamped',
        'nav_msgs/msg/Odometry',
        IMU_TYPE,
    ],
)
def test_all_types_of_orientations_are_read(kind, tmp_path, caplog):
    quaternion, stamp = (0.1, 0.2, 0.3, 0.927), 10**18 + 7
    unknown = imu_message(stamp, (0, 0, 0), (0, 0, 9.8))
    topics = {
        (TOPIC, IMU_TYPE): [(stamp, unknown)],
        ('/body', kind): [(stamp, stamped(kind, '', stamp, quaternion))],
    }
    bag = write(tmp_path / 'bag', topics)
    found = read_orientations(bag, 'body')
    assert found.stamps.tolist() == [stamp]
    np.testing.assert_array_equal(found.orientations, [quaternion])
    damaged = stamped(kind, '', stamp, quaternion)[:20]
    with_damage = write(
        tmp_path / 'damaged',
        topics
        | {
            ('/body', kind): [(stamp, damaged), *topics['/body', kind]],
            ('/lost', kind): [(stamp, damaged)],
        },
    )
    np.testing.assert_array_equal(read_orientations(with_damage, 'body').orientations, [quaternion])
    assert '1 message of /body can not be read' in caplog.text
    with pytest.raises(BagError, match='1 message of /lost can not be read'):
        read_orientations(with_damage, 'lost')
    with pytest.raises(BagError, match='no message with an orientation'):
        read_orientations(bag, TOPIC)
    with pytest.raises(
        BagError, match='no topic /nose in the bag; of a type that has an orientation: /body'
    ):
        read_orientations(bag, '/nose')
