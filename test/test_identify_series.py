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

"""Series in files, in parts: the same numbers as arrays in memory."""

import gc
from pathlib import Path

import numpy as np
import pytest

from gyro_drift_filter.identify import IdentificationError, allan, series, spectrum
from gyro_drift_filter.identify.allan import allan_deviation
from gyro_drift_filter.identify.series import Ramp, Stored, Stretch, block_means, parts, thinned
from gyro_drift_filter.identify.tones import find_tones


def stored(values):
    out = Stored(values.dtype.type)
    for part in np.array_split(values, 7):
        out.append(part)
    return out


def open_files():
    return len(list(Path('/proc/self/fd').iterdir()))


def test_what_was_stored_is_read(random):
    values = random.standard_normal(300_000)  # more than stays in memory
    series_ = stored(values)
    assert len(series_) == len(values)
    np.testing.assert_array_equal(series_, values)
    np.testing.assert_array_equal(series_[1000:1005], values[1000:1005])
    np.testing.assert_array_equal(Stretch(series_, 50, 90)[10:100], values[60:90])
    np.testing.assert_array_equal(np.concatenate(list(parts(series_, 1000))), values)
    np.testing.assert_allclose(Ramp(5.0, 0.1, 10)[3:5], [5.3, 5.4])


def test_a_file_goes_with_its_series(random):
    before = open_files()
    series_ = stored(random.standard_normal(300_000))
    assert open_files() == before + 1
    del series_
    gc.collect()
    assert open_files() == before


def test_a_full_disk_is_one_line():
    full = Stored()
    full._file = Path('/dev/full').open('wb', buffering=0)  # noqa: SIM115
    with pytest.raises(IdentificationError, match=r'no space left in .*TMPDIR'):
        full.append(np.zeros(10))
    full._file.close()


def test_blocks_reach_over_parts(random, monkeypatch):
    monkeypatch.setattr(series, 'LARGEST_PART', 100)
    spans = [random.standard_normal(n) for n in (90, 1250, 333)]
    expected = [block.mean() for block in np.split(np.concatenate(spans), [557, 1115])]
    np.testing.assert_allclose(block_means(spans, 3), expected)
    assert len(thinned(spans)) <= 110


def test_a_long_span_in_parts_has_the_allan_deviation_of_the_whole(random, monkeypatch):
    values = random.standard_normal(2**17) + 0.02 * np.cumsum(random.standard_normal(2**17))
    whole = allan_deviation([values], 0.01)
    for module in (allan, series):
        monkeypatch.setattr(module, 'LARGEST_PART', 2**14)
    monkeypatch.setattr(series.parts, '__defaults__', (2**14,))
    parted = allan_deviation([values], 0.01)
    np.testing.assert_array_equal(parted.taus, whole.taus)
    np.testing.assert_allclose(parted.deviations, whole.deviations, rtol=0.03)


def test_a_long_span_in_parts_has_the_spectrum_of_the_whole(random, monkeypatch):
    values = random.standard_normal(2**17)
    whole = spectrum.spectrum([values])
    monkeypatch.setattr(series.parts, '__defaults__', (2**14,))
    monkeypatch.setattr(spectrum, 'LARGEST_PART', 2**14)
    parted = spectrum.spectrum([stored(values)])
    assert parted.weight.sum() == pytest.approx(whole.weight.sum(), rel=0.01)
    mean = np.average(whole.power, weights=whole.weight)
    assert np.average(parted.power, weights=parted.weight) == pytest.approx(mean, rel=0.01)


@pytest.mark.slow
def test_a_tone_is_found_and_coloured_noise_has_none(random):
    noise = np.convolve(random.standard_normal(60_050), np.exp(-np.arange(50) / 8), 'valid')
    assert find_tones([noise], 0.01) == ()
    time = np.arange(len(noise)) * 0.01
    (tone,) = find_tones([noise + 0.4 * np.sin(2 * np.pi * 31.7 * time)], 0.01)
    assert tone.frequency == pytest.approx(31.7, abs=0.02)
    assert tone.amplitude == pytest.approx(0.4, rel=0.05)


@pytest.mark.slow
def test_a_real_sensor_has_its_tone(real):
    _, rates, _ = real('static_adis16405')
    (tone,) = find_tones([rates[:, 2] - rates[:, 2].mean()], 0.01)
    assert tone.frequency == pytest.approx(21.0, abs=0.5)
    assert find_tones([rates[:, 0] - rates[:, 0].mean()], 0.01) == ()
