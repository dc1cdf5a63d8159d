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


"""`gyro_drift explain`: each flagged sample is listed once, with why and what came of it."""

import json
import re
from functools import partial, partialmethod

import numpy as np
import pytest

from gyro_drift_filter.cli.explain import page
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods.reasons import REASONS, Reason
from gyro_drift_filter.core.sample import STARTED, UNUSABLE
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.messages.outlier_reason import reason_name, reason_text
from gyro_drift_filter.report.flagged import FlaggedLog, FlaggedSequence
from gyro_drift_filter.simulation.bag import TOPIC, imu_message, imu_messages
from support.bags import write, write_imus
from support.chunks import filtered_imus
from support.messages import START, even_stamps
from support.sensor import at_rest

SPIKE, SECOND, UNUSABLE_TEXT = 2.0, 100, 'no usable number'
AGREED = REASONS[Reason.AGREED]


@pytest.fixture
def rates_and_forces(random):
    """Return 20 s of rest in which all kinds of samples are flagged."""
    rates, forces = at_rest(random, 20)
    rates[10 * SECOND, 0] += SPIKE
    rates[12 * SECOND, 1] = np.nan
    rates[14 * SECOND : 14 * SECOND + 2, 2] += SPIKE
    rates[16 * SECOND :, 0] += SPIKE  # it stays, so it is motion
    rates[-1, 1] -= SPIKE
    return rates, forces


@pytest.fixture
def bag(tmp_path, rates_and_forces):
    stamps = even_stamps(len(rates_and_forces[0]))
    return write_imus(tmp_path / 'drive', stamps, *rates_and_forces)


def explained(bag, tmp_path, *options):
    """Return what the command writes for programs."""
    target = tmp_path / f'{len(options)}.json'
    assert main(['explain', str(bag), '--json', str(target), *options]) == 0
    return json.loads(target.read_text())


def test_every_reason_has_its_text():
    assert set(REASONS) == set(Reason)
    assert len(set(REASONS.values())) == len(Reason)


def test_every_reason_has_its_name():
    assert [reason_name('adaptive', reason) for reason in Reason] == [r.name for r in Reason]
    assert reason_name('kalman', 0) == 'EXPECTED'
    assert reason_name('kalman', UNUSABLE) == 'UNUSABLE'
    assert reason_name('adaptive', STARTED) == 'STARTED'


def test_the_command_says_why_and_what_came_of_it(bag, tmp_path, capsys):
    result = explained(bag, tmp_path)
    found = {
        (round((one['log_time'] - START) * 1e-9, 2), 'xyz'[one['axis']]): one
        for one in result['flagged']
    }
    assert list(found) == [(10.0, 'x'), (12.0, 'y'), (14.0, 'z'), (16.0, 'x'), (19.99, 'y')]
    assert [one['number'] for one in found.values()] == [1000, 1200, 1400, 1600, 1999]
    spike, unusable, two, motion, last = found.values()
    assert (spike['samples'], spike['reason']) == (1, REASONS[Reason.FAR_WHILE_STILL])
    assert spike['outcome'] == two['outcome'] == REASONS[Reason.RETURNED]
    assert spike['rate'] == pytest.approx(SPIKE, abs=0.1)
    assert spike['innovation'] == pytest.approx(SPIKE, abs=0.1)
    assert 0.0 < spike['deviation'] < 0.01
    assert 0.02 < spike['innovation_threshold'] < 0.1
    assert spike['least_jump'] == pytest.approx(0.5 * 250.0 / 100.0**2)
    names = [(one['reason_name'], one['outcome_name']) for one in found.values()]
    assert names[:2] == [('FAR_WHILE_STILL', 'RETURNED'), ('UNUSABLE', 'EXPECTED')]
    assert names[2:] == [
        ('FAR_WHILE_STILL', 'RETURNED'),
        ('FAR_WHILE_STILL', 'AGREED'),
        ('FAR_WHILE_STILL', None),
    ]
    assert (unusable['samples'], unusable['reason']) == (1, UNUSABLE_TEXT)
    assert unusable['innovation'] == 0.0
    assert unusable['innovation_threshold'] is unusable['least_jump'] is None
    assert two['samples'] == 2
    assert motion['outcome'] == AGREED
    assert last['outcome'] is None
    page = capsys.readouterr().out
    assert page.startswith(f'drive, topic {TOPIC}, adaptive: ')
    assert f'{sum(one["samples"] for one in found.values())} samples flagged in 5 sequences' in page
    assert '  10.000    x       1        2          2 ' in page
    assert 'the recording ends here' in page
    limits = {name: Parameters().names()[name] for name in ('outlier.threshold', 'outlier.run')}
    assert result['parameters'] == limits
    assert 'named here:\n     7.0  outlier.threshold\n       3  outlier.run\n\n' in page


@pytest.mark.slow
def test_what_nobody_asks_for_is_not_made(bag, monkeypatch):
    """Reports took most of the time on long recordings of a slow sensor."""
    made, whole = [], {name: getattr(Health, name) for name in ('rules', 'statuses')}

    def count(name, *arguments, **keywords):
        made.append(name)
        return whole[name](*arguments, **keywords)

    for name in whole:
        monkeypatch.setattr(Health, name, partialmethod(partial(count, name)))
    # The summary at the end has a status.
    assert main(['explain', str(bag)]) == 0
    assert made == ['rules', 'statuses']
    made.clear()
    main(['doctor', str(bag)])
    assert len(made) > 10
    assert 'statuses' not in made


def test_the_filter_sees_what_comes_before_the_start(bag, tmp_path):
    """So the samples are those that were flagged on the robot."""
    whole = explained(bag, tmp_path)['flagged']
    part = explained(bag, tmp_path, '--start', '13', '--end', '15')['flagged']
    assert part == whole[2:3]


def test_the_methods_of_the_paper_have_their_reason(bag, tmp_path):
    result = explained(bag, tmp_path, '--method', 'kalman')
    reasons = {one['reason'] for one in result['flagged']}
    assert result['method'] == 'kalman'
    assert any('epsilon' in reason for reason in reasons)
    assert {one['reason_name'] for one in result['flagged']} == {'BEYOND_EPSILON', 'UNUSABLE'}
    assert all(one['innovation_threshold'] is None for one in result['flagged'])
    assert result['parameters'] == {'epsilon': Parameters().epsilon}
    assert reasons <= {UNUSABLE_TEXT, *(r for r in reasons if 'epsilon' in r)}


def test_diagnostics_say_why_the_last_outlier_was_flagged(rates_and_forces):
    """Of several in a row the first one; another method has reasons of its own."""
    filter_ = MessageFilter(Parameters())

    def told(samples):
        for k in samples:
            stamp = START + 10_000_000 * k
            rate, force = (values[k] for values in rates_and_forces)
            filter_.take(imu_message(stamp, rate, force))
        values = Health().judge(filter_.report(), 1.0)[1].values
        ages.append([values[f'Time since the last outlier (s) {axis}'] for axis in 'xyz'])
        return [values[f'Why the last outlier was flagged {axis}'] for axis in 'xyz']

    ages, spike, none = [], REASONS[Reason.FAR_WHILE_STILL], 'none so far'
    assert told(range(10 * SECOND)) == [none, none, none]
    assert told(range(10 * SECOND, 13 * SECOND)) == [spike, UNUSABLE_TEXT, none]
    assert told(range(13 * SECOND, 15 * SECOND)) == [spike, UNUSABLE_TEXT, spike]
    filter_.filter.configure(Parameters(method='kalman'))
    assert told(range(15 * SECOND, 15 * SECOND + 1)) == [spike, UNUSABLE_TEXT, spike]
    assert ages[:2] == [[none] * 3, ['2.99', '0.99', none]]
    assert ages[2] == ['4.99', '2.99', '0.98']


def test_a_long_list_ends_with_how_many_more_there_are():
    one = FlaggedSequence(0, 0, 0, 1, 1.0, 1.0, 0.01, 'far', 'back')
    text = page('drive', 500 * [one], 0, {})
    assert text.startswith('drive: 500 samples flagged in 500 sequences')
    more = 'and 300 more sequences: --start and --end show those of a time, --json writes all'
    assert text.endswith(more)
    assert text.count('-> back') == 200


def test_of_too_many_sequences_the_farthest_are_listed():
    """The first ones were, which of a day are those of its first hour."""
    of_hours = [
        FlaggedSequence(0, 3600 * 10**9 * k, k, 1, 1.0, 0.01 * k, 0.01, 'far', 'back')
        for k in range(500)
    ]
    text = page('drive', of_hours, 0, {})
    assert 'The first sample of the 200 sequences with most deviations, with rates' in text
    listed = re.findall(r'^ *(\d+)\.000    x', text, re.MULTILINE)
    assert [int(seconds) // 3600 for seconds in listed] == list(range(300, 500))


def test_nothing_flagged_and_wrong_options(bag, tmp_path, capsys):
    quiet = tmp_path / 'quiet.yaml'
    quiet.write_text('gyro_drift_filter:\n  ros__parameters:\n    outlier.enabled: false\n')
    assert main(['explain', str(bag), '--params', str(quiet), '--end', '11']) == 0
    page = capsys.readouterr().out
    assert page == f'drive, topic {TOPIC}, adaptive: no sample flagged\n'
    assert main(['explain', str(bag), '--topic', '/none']) == 1
    assert '/none' in capsys.readouterr().err
    assert main(['explain', str(tmp_path / 'absent')]) == 1
    assert 'absent' in capsys.readouterr().err


def explained_page(tmp_path, capsys, stamps, rates, forces):
    """Return what the command prints of a recording with stamps in ns since START."""
    rows = imu_messages(START + np.asarray(stamps), rates, forces)
    assert main(['explain', str(write(tmp_path / 'drive', {(TOPIC, IMU_TYPE): rows}))]) == 0
    return capsys.readouterr().out


def told_of_each(page):
    """Return (reason, outcome) of each time that samples were flagged."""
    lines = page.split('deviations\n')[1].splitlines()
    return [
        (reason.strip(), outcome.strip()[3:])
        for reason, outcome in zip(lines[1::3], lines[2::3], strict=True)
    ]


def test_what_lies_behind_a_gap_is_explained_by_the_gap(tmp_path, capsys, random):
    """A sample may wait for the next one although nothing was held back before it."""
    rates, forces = at_rest(random, 20)
    stamps = 10_000_000 * np.arange(len(rates))
    rates[[1000, 1200, 1400], 0] += SPIKE
    stamps[1201:] += 3_000_000_000  # beyond gap_limit
    stamps[1401:] += 50_000_000
    kept = np.arange(len(rates)) != 999
    page = explained_page(tmp_path, capsys, stamps[kept], rates[kept], forces[kept])
    returned = REASONS[Reason.RETURNED]
    assert told_of_each(page) == [
        (REASONS[Reason.BEYOND_REACH], returned),
        (REASONS[Reason.FAR_WHILE_STILL], reason_text('adaptive', STARTED)),
        (REASONS[Reason.FAR_WHILE_STILL], returned),
    ]


@pytest.mark.parametrize('shake', [0.0, 20.0])
def test_a_knock_whose_angle_is_given_back_is_not_called_an_outlier(
    shake, tmp_path, capsys, random
):
    rates, forces = at_rest(random, 20)
    rates[1000, 1] += 1.5
    forces[1000, 0] += shake
    page = explained_page(tmp_path, capsys, 10_000_000 * np.arange(len(rates)), rates, forces)
    outcome = Reason.KNOCKED if shake else Reason.RETURNED
    assert told_of_each(page) == [(REASONS[Reason.FAR_WHILE_STILL], REASONS[outcome])]
    assert '1 sample flagged in 1 sequence (each axis counted by itself)\n' in page


def test_reads_that_go_on_failing_are_not_called_motion(tmp_path, capsys, random):
    rates, forces = at_rest(random, 20)
    rates[1000:] += (1.0 - np.cos(0.05 * np.arange(1000)))[:, None]
    rates[1520:1540] = 0.0
    page = explained_page(tmp_path, capsys, 10_000_000 * np.arange(len(rates)), rates, forces)
    failed = REASONS[Reason.DROPOUT], REASONS[Reason.DROPOUT_GOES_ON]
    assert told_of_each(page) == 3 * [failed]
    assert '       3  ' + failed[0] in page
    assert '       3  ' + failed[1] in page


def test_a_rate_that_is_no_rate_has_missed_nothing(tmp_path, capsys, random):
    rates, forces = at_rest(random, 5)
    rates[300, 0] = 1e9
    page = explained_page(tmp_path, capsys, 10_000_000 * np.arange(len(rates)), rates, forces)
    assert '   3.000    x       1    1e+09          -          -          -          -\n' in page


def test_nothing_to_look_at_is_an_error(bag, tmp_path, capsys):
    """Else an empty topic would seem to have no outliers."""
    empty = write(tmp_path / 'empty', {(TOPIC, IMU_TYPE): []})
    assert main(['explain', str(empty)]) == 1
    assert f'topic {TOPIC} has no messages' in capsys.readouterr().err
    rows = [(START + k, imu_message(START + k, [np.nan] * 3, np.ones(3))) for k in range(100)]
    broken = write(tmp_path / 'broken', {(TOPIC, IMU_TYPE): rows})
    assert main(['explain', str(broken)]) == 1
    told = f'nothing of topic {TOPIC} can be filtered: no rate is a number'
    assert told in capsys.readouterr().err
    # `replay` tells it in the same words.
    assert main(['replay', str(broken), '-o', str(tmp_path / 'out')]) == 1
    assert told in capsys.readouterr().err
    assert main(['explain', str(bag), '--start', '30']) == 1
    assert 'lasts for 19.99 s, and ends before --start' in capsys.readouterr().err


def test_the_diagnostics_tell_the_reason_of_the_method_that_flagged(rates_and_forces):
    """The number that means an outlier to the paper's methods is another reason of `adaptive`."""
    filter_ = MessageFilter(Parameters(method='kalman'))
    for k in range(11 * SECOND):
        rate, force = (values[k] for values in rates_and_forces)
        filter_.take(imu_message(START + 10_000_000 * k, rate, force))
    filter_.filter.configure(Parameters())
    _, of_filter = Health().judge(filter_.report(), 1.0)
    assert 'epsilon' in of_filter.values['Why the last outlier was flagged x']


def test_a_bridged_repeat_ends_no_outliers_in_a_row(tmp_path, capsys, random):
    """Neither on the robot nor in a bag: it tells nothing."""
    rates, forces = at_rest(random, 20)
    rates[1000:] += (1.0 - np.cos(0.05 * np.arange(1000)))[:, None]
    rates[[1500, 1502]] += 30.0
    for repeat in (*range(100, 1400, 50), 1501):
        rates[repeat], forces[repeat] = rates[repeat - 1], forces[repeat - 1]
    stamps, filter_ = 10_000_000 * np.arange(len(rates)), MessageFilter(Parameters())
    for _, message in imu_messages(START + stamps, rates, forces):
        filter_.take(message)
    _, of_filter = Health().judge(filter_.report(), 1.0)
    page = explained_page(tmp_path, capsys, stamps, rates, forces)
    assert [reason for reason, _ in told_of_each(page)] == 3 * [REASONS[Reason.BEYOND_BODY]]
    for axis in 'xyz':
        live = of_filter.values[f'Why the last outlier was flagged {axis}']
        assert live == REASONS[Reason.BEYOND_BODY]
        assert f' {axis}       2 ' in page


def logged(filter_, stamps, rates, forces, piece):
    """Return the messages that a filter has taken, and the log that took them so many at a time."""
    imus = filtered_imus(filter_, stamps, rates, forces)
    log = FlaggedLog(filter_)
    for begin in range(0, len(imus), piece):
        log.take(imus[begin : begin + piece], stamps[begin : begin + piece])
    return imus, log


@pytest.mark.slow
@pytest.mark.parametrize('piece', [1, 7, 10_000])
@pytest.mark.parametrize('method', ['adaptive', 'sage_husa'])
def test_pieces_of_any_size_give_the_same(piece, method, rates_and_forces):
    rates, forces = rates_and_forces
    rates[11 * SECOND :: 37, 0] += 0.4  # many more
    stamps = even_stamps(len(rates))
    imus, log = logged(Filter(Parameters(method=method)), stamps, rates, forces, piece)
    flagged = imus['result']['outlier'] > 0.0
    assert ((imus['result']['reason'] == UNUSABLE) == np.isnan(rates)).all()
    samples = np.zeros(3, int)
    for sequence in log.sequences:
        samples[sequence.axis] += sequence.samples
        row = int(np.searchsorted(stamps, sequence.log_time))
        assert flagged[row, sequence.axis]
        behind = row + sequence.samples
        assert (sequence.outcome is None) == (behind >= len(rates))
    assert (samples == flagged.sum(axis=0)).all()
    assert samples[0] > 5
    starts = flagged & ~np.roll(flagged, 1, axis=0)
    assert len(log.sequences) == starts.sum()


def test_the_methods_of_the_paper_name_the_square_that_they_compare():
    """Equation (18) compares the square of the sample; it was called that of the innovation."""
    told = reason_text('sage_husa', 1)
    assert 'square of the rate' in told
    assert 'innovation' not in told


def test_a_result_has_the_limits_that_its_innovation_was_held_against(rates_and_forces):
    """So that the decision can be made again by hand, and a parameter turned as far as needed."""
    rates, forces = rates_and_forces
    rates[600:900] += np.sin(0.05 * np.arange(300))[:, None]
    rates[700, 2] += SPIKE
    rates[800, 2] += 30.0
    stamps = even_stamps(len(rates))
    results = Filter(Parameters()).run(stamps, rates, forces)
    size = np.abs(results['innovation'])
    threshold, least_jump = results['innovation_threshold'], results['least_jump']
    reasons = results['reason']
    far = np.isin(reasons, [Reason.FAR, Reason.FAR_WHILE_STILL, Reason.BEYOND_BODY])
    assert far.sum() >= 6
    assert (size > np.maximum(threshold, least_jump))[far].all()
    expected = reasons[200:] == Reason.EXPECTED
    within = size <= np.maximum(threshold, least_jump)
    behind_far = np.roll(far, 1, axis=0)[200:]
    assert within[200:][expected & ~behind_far].all()
    assert least_jump[700, 2] == pytest.approx(80.0 / 100.0)
    assert least_jump[800, 2] == pytest.approx(1000.0 / 100.0)
    assert reasons[800, 2] == Reason.BEYOND_BODY
    assert least_jump[1000, 0] == pytest.approx(0.5 * 250.0 / 100.0**2)
    for row, axis in ((0, 0), (1200, 1)):  # it starts there, or there is no usable number
        assert threshold[row, axis] == least_jump[row, axis] == 0.0


def test_what_is_not_judged_by_its_innovation_has_no_limits(random):
    rates, forces = at_rest(random, 20)
    rates[1000:] += (1.0 - np.cos(0.05 * np.arange(1000)))[:, None]
    rates[1520:1522] = 0.0
    stamps = even_stamps(len(rates))
    failed = Filter(Parameters()).run(stamps, rates, forces)[1520]
    assert (failed['reason'] == Reason.DROPOUT).all()
    assert (failed['innovation_threshold'] == 0.0).all()
    assert (failed['least_jump'] == 0.0).all()


@pytest.mark.parametrize(('more', 'flagged'), [(0.98, 1.0), (1.02, 0.0)])
def test_the_limit_says_how_far_to_turn_the_threshold(more, flagged, random):
    rates, forces = at_rest(random, 11)
    rates[1000, 0] += 0.06
    stamps = even_stamps(len(rates))
    spike = Filter(Parameters()).run(stamps, rates, forces)[1000]
    assert spike['reason'][0] == Reason.FAR_WHILE_STILL
    needed = 7.0 * abs(spike['innovation'][0]) / spike['innovation_threshold'][0]
    raised = Filter(Parameters(outlier_threshold=more * needed))
    assert raised.run(stamps, rates, forces)[1000]['outlier'][0] == flagged


def test_the_methods_of_the_paper_hold_no_innovation_against_a_limit(rates_and_forces):
    rates, forces = rates_and_forces
    stamps = even_stamps(len(rates))
    results = Filter(Parameters(method='kalman')).run(stamps, rates, forces)
    assert (results['innovation_threshold'] == 0.0).all()
    assert (results['least_jump'] == 0.0).all()


def test_what_is_replaced_or_passed_on_without_a_flag_is_counted(tmp_path, capsys, random):
    """A flag tells of outliers alone; who asks why rates were replaced has to find the rest."""
    rates, forces = at_rest(random, 20)
    rates[1000:] += (2.0 - 2.0 * np.cos(0.05 * np.arange(1000)))[:, None]
    rates = np.minimum(rates, 3.5)
    for repeat in (*range(100, 1400, 50), 1501, 1502):
        rates[repeat], forces[repeat] = rates[repeat - 1], forces[repeat - 1]
    stamps = 10_000_000 * np.arange(len(rates))
    reasons = Filter(Parameters()).run(START + stamps, rates, forces)['reason']
    page = explained_page(tmp_path, capsys, stamps, rates, forces)
    heading = 'Not flagged, and decided by other rules than the two limits:\n'
    told = page.split(heading)[1].split('\n\n')[0]
    for axis, name in enumerate('xyz'):
        for reason in (Reason.AT_LIMIT, Reason.REPEATED):
            rows = np.flatnonzero(reasons[:, axis] == reason)
            line = f'{len(rows):8}  {name}, from {rows[0] / 100:.3f} to {rows[-1] / 100:.3f} s'
            assert len(rows) > 10
            assert f'{line}, up to ' in told
    assert told.count(REASONS[Reason.AT_LIMIT]) == told.count(REASONS[Reason.REPEATED]) == 3


def test_each_sample_is_told_once(bag, tmp_path):
    """What comes behind flagged samples is told with them."""
    assert explained(bag, tmp_path)['unflagged'] == []


@pytest.mark.slow
@pytest.mark.parametrize('piece', [1, 7, 10_000])
def test_unflagged_samples_are_counted_within_the_times_asked_for(piece, random):
    rates, forces = at_rest(random, 12)
    rates[1050:1100, 2] = 0.001  # a driver that hangs
    stamps = even_stamps(len(rates))
    imus, log = logged(Filter(Parameters()), stamps, rates, forces, piece)
    reason = imus['result']['reason'][:, 2]
    samples = {one.reason_name: one for one in log.unflagged(START, 0.0, np.inf) if one.axis == 2}
    assert 'CONSTANT' in samples
    for name, one in samples.items():
        rows = np.flatnonzero(reason == Reason[name])
        assert one.samples == len(rows)
        assert (one.first, one.last) == (stamps[rows[0]], stamps[rows[-1]])
    first = 1e-9 * (samples['CONSTANT'].first - START)
    part = log.unflagged(START, first - 0.001, first + 0.001)
    assert [(one.reason_name, one.samples, one.longest) for one in part] == [('CONSTANT', 1, 1)]
    assert log.unflagged(START, 0.0, 10.0) == []
