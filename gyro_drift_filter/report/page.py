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

"""The page: verdicts and figures of one or several recordings in one file that needs no network."""

import base64
import hashlib
import html
import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from gyro_drift_filter.core.parameters import AXES, FIELDS, Parameters
from gyro_drift_filter.errors import printable
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.phrases import counted
from gyro_drift_filter.report.figures import Drawer, Figure, Trace
from gyro_drift_filter.report.verdict import BiasSource, Verdict
from gyro_drift_filter.report.wording import headline, per_minute, statements

# What a page may have in bytes, for mail and for pull requests.
LARGEST_PAGE = 15_000_000
# Of them what is not traces: the library, styles, and text.
_BESIDE = 700_000
# A point is four bytes of time and four of value, in base64.
_POINT_BYTES = 8 * 4 / 3
_TICKS = 2**32 - 1
# Nothing is loaded from anywhere, and no script runs but those of this page.
_POLICY = (
    "default-src 'none'; script-src {}; style-src 'unsafe-inline'; img-src data: blob:; "
    "font-src data:; connect-src 'none'; base-uri 'none'; form-action 'none'"
)
# Buttons would do nothing, and of several recordings the others could not be chosen.
_WITHOUT_SCRIPT = (
    '#bar, figure, .plot { display: none; } section.bag { display: block !important; }'
)


class DrawnRecording:
    """What the page shows of one recording.

    Attributes:
        name: Of the bag.
        verdicts: By method; figures are of the first one, if not said otherwise.
        figures: In their order.
        rests: Begin and end of each in s.
        seconds: That the horizontal axis shows.
        roles: Names of what can be shown and hidden, by role.
        parameters: Of the filter.
        facts: Where it all comes from: pairs of what and which.
        notes: Sentences on the recording.
    """

    def __init__(
        self,
        name: str,
        drawer: Drawer,
        summaries: Mapping[str, Summary],
        parameters: Parameters,
        facts: list[tuple[str, str]],
        notes: Sequence[str] = (),
    ) -> None:
        """Draw the figures, and judge by the summary of each method."""
        self.name = name
        self.verdicts = {
            method: signals.watch.verdict(summaries[method])
            for method, signals in drawer.runs.items()
        }
        self.figures = drawer.figures()
        self.rests = drawer.rest_times()
        self.seconds = next(iter(summaries.values())).seconds
        self.roles = drawer.roles()
        self.parameters = parameters
        self.facts = facts
        self.notes = notes


def when_recorded(summary: Summary, period: float, among: str = '') -> tuple[str, str]:
    """Return the fact when a recording was made, how long it is, and what is in it.

    Args:
        summary: Of a filter over the recording.
        period: Of its samples in s.
        among: What its Imu messages are among, as the end of a clause.
    """
    begin = datetime.fromtimestamp(summary.start * 1e-9, UTC)
    rate = f', {1.0 / period:.4g} Hz' if summary.received > 1 else ''
    return 'recorded', (
        f'{begin:%Y-%m-%d %H:%M:%S} UTC by its log times, {summary.seconds:.1f} s, '
        f'{counted(summary.received, "Imu message")}{among}{rate}'
    )


def points_for(recordings: int) -> int:
    """Return how many points a recording may have on a page of so many, all traces together."""
    room = LARGEST_PAGE - len(get_plotlyjs().encode()) - _BESIDE
    return int(room / _POINT_BYTES / recordings)


def page(recordings: Sequence[DrawnRecording]) -> str:
    """Return the page as HTML; all text that comes from outside is escaped."""
    several = len(recordings) > 1
    title = 'gyro_drift report: ' + ', '.join(recording.name for recording in recordings)
    bar = _bar(recordings)
    sections = [
        _section(k, recording, '' if several else bar) for k, recording in enumerate(recordings)
    ]
    data: dict[str, Any] = {f'data-{k}': _data(recording) for k, recording in enumerate(recordings)}
    later = {
        f'data-{k}-{i}': _packed_panels(figure, recording)
        for k, recording in enumerate(recordings)
        for i, figure in enumerate(recording.figures)
    }
    # The first figure is drawn while the browser still reads the others.
    data['data-0-0'] = later.pop('data-0-0')
    body = [bar if several else '', *sections]
    return document(title, body, data, _resource('page.js'), later)


def document(
    title: str,
    body: Sequence[str],
    data: Mapping[str, Any],
    script: str,
    later: Mapping[str, Any] | None = None,
) -> str:
    """Return a page that needs no network, with the library that draws on it.

    All text from outside is escaped in the body already. The script finds the data as JSON, each
    in the element with its name as `id`, and `later` when the document is loaded.
    """
    scripts = [get_plotlyjs(), script]
    hashes = ' '.join(f"'sha256-{_digest(script)}'" for script in scripts)
    return '\n'.join(
        [
            '<!DOCTYPE html>',
            '<html lang="en" data-theme="light">',
            '<head>',
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY.format(hashes)}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<title>{text_of(title)}</title>',
            f'<style>{_resource("page.css")}</style>',
            f'<noscript><style>{_WITHOUT_SCRIPT}</style></noscript>',
            '</head>',
            '<body>',
            '<noscript><p class="headline unsure">The figures are missing: this browser does not '
            'run the JavaScript that draws them. All else is here.</p></noscript>',
            *body,
            *_data_elements(data),
            *(f'<script>{script}</script>' for script in scripts),
            *_data_elements(later or {}),
            '</body>',
            '</html>\n',
        ]
    )


def _data_elements(data: Mapping[str, Any]) -> Iterable[str]:
    for name, plain in data.items():
        yield f'<script type="application/json" id="{name}">{_within_script(plain)}</script>'


def _within_script(plain: Any) -> str:
    """Return JSON that can stand within a script."""
    text = json.dumps(plain, allow_nan=False, separators=(',', ':'))
    return text.replace('<', '\\u003c').replace('>', '\\u003e').replace('&', '\\u0026')


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding='utf-8')


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def text_of(text: str) -> str:
    """Return text from outside as HTML, in one line."""
    return html.escape(printable(text))


def _bar(recordings: Sequence[DrawnRecording]) -> str:
    """Return the buttons that hold for all figures."""
    roles: dict[str, str] = {}
    for recording in recordings:
        roles |= recording.roles
    choices = ''.join(f'<option value="{k}">{text_of(r.name)}' for k, r in enumerate(recordings))
    choice = f'<select id="choice" aria-label="recording">{choices}</select>'
    shown = ''.join(
        f'<button data-role="{role}" aria-pressed="true"><i></i>{text_of(name)}</button>'
        for role, name in roles.items()
    )
    axes = ''.join(
        f'<button data-axis="{axis}" aria-pressed="true">{axis}</button>' for axis in AXES
    )
    actions = ''.join(
        f'<button data-action="{action}" title="{title}" aria-label="{title}">{sign}</button>'
        for action, title, sign in (
            ('left', 'earlier (left arrow in a figure)', '&larr;'),
            ('right', 'later (right arrow)', '&rarr;'),
            ('closer', 'closer (+)', '+'),
            ('wider', 'wider (-)', '&minus;'),
            ('all', 'all of it (Home)', 'all'),
        )
    )
    return (
        f'<nav id="bar" aria-label="figures">{choice if len(recordings) > 1 else ""}'
        f'<span>{shown}</span><span>{axes}</span><span>{actions}</span>'
        '<span class="soft" id="where" aria-live="polite"></span>'
        '<span><button id="theme"></button></span></nav>'
    )


def _section(number: int, recording: DrawnRecording, bar: str) -> str:
    method, verdict = next(iter(recording.verdicts.items()))
    said = ''.join(
        f'<dt>{text_of(about)}</dt><dd>{text_of(text)}</dd>' for about, text in statements(verdict)
    )
    in_time = [k for k, figure in enumerate(recording.figures) if figure.in_time]
    beside = [k for k, figure in enumerate(recording.figures) if not figure.in_time]
    return '\n'.join(
        [
            f'<section class="bag" id="bag-{number}"{" hidden" if number else ""}>',
            f'<h1>{text_of(recording.name)}, topic {text_of(verdict.topic)}</h1>',
            f'<p class="headline {verdict.outcome}">{text_of(headline(verdict))}</p>',
            f'<dl>{said}</dl>',
            *(f'<p>{text_of(note)}</p>' for note in recording.notes),
            _axes_table(verdict, method),
            _comparison(recording.verdicts) if len(recording.verdicts) > 1 else '',
            bar,
            *(_figure(number, k, recording.figures[k]) for k in in_time),
            '<div class="pairs">',
            *(_figure(number, k, recording.figures[k]) for k in beside),
            '</div>',
            _provenance(recording),
            '</section>',
        ]
    )


def _figure(number: int, k: int, figure: Figure) -> str:
    keys = ' Arrow keys move, + and - zoom, Home shows all.' if figure.in_time else ''
    label = html.escape(f'{figure.title}: {", ".join(figure.panels)} over {figure.x}.{keys}')
    return (
        f'<figure id="{figure.name}-{number}"><h2>{text_of(figure.title)}</h2>'
        f'<figcaption>{text_of(figure.text)}</figcaption>'
        f'<div class="plot" data-figure="{k}" tabindex="0" role="group" aria-label="{label}">'
        '</div></figure>'
    )


def _cell(name: str, value: float, text: str, *, known: bool = True) -> str:
    """Return a cell with a figure; programs find its value in SI units by its name in the JSON.

    A value that is not known, such as the bias without a rest, is there for programs, but is not
    shown.
    """
    shown = text if known and np.isfinite(value) else '-'
    return f'<td data-name="{name}" data-value="{float(value)!r}">{shown}</td>'


def table_of(head: Iterable[str], rows: Iterable[str], attributes: str = '') -> str:
    """Return a table of a head as text and rows as cells in HTML; attributes begin with a space."""
    cells = ''.join(f'<th scope="col">{text_of(name)}</th>' for name in head)
    body = ''.join(f'<tr>{row}</tr>' for row in rows)
    return (
        f'<div class="wide"><table{attributes}><thead><tr>{cells}</tr></thead>'
        f'<tbody>{body}</tbody></table></div>'
    )


def _axes_table(verdict: Verdict, method: str) -> str:
    """Return bias and noise of each axis."""
    rows = []
    for axis, name in enumerate(AXES):
        values = (
            ('bias.rates', verdict.bias.rates, True),
            ('bias.deviations', verdict.bias.deviations, True),
            ('rests.raw_deviation', verdict.rests.raw_deviation, True),
            ('rests.filtered_deviation', verdict.rests.filtered_deviation, True),
            ('rests.ratio', verdict.rests.ratio, False),
            ('change_in_motion', verdict.change_in_motion, True),
        )
        heard = not verdict.silent[axis]
        bias_known = heard and verdict.bias.source != BiasSource.UNKNOWN
        cells = ''.join(
            _cell(
                f'{key}.{axis}',
                of_axes[axis],
                f'{np.degrees(of_axes[axis]) if turns else of_axes[axis]:.4f}',
                known=bias_known if key == 'bias.rates' else heard,
            )
            for key, of_axes, turns in values
        )
        flagged = int(verdict.outliers.axes[axis])
        silent = f' ({text_of(verdict.silent[axis])})' if verdict.silent[axis] else ''
        rows.append(
            f'<th scope="row">{name}{silent}</th>{cells}'
            + _cell(
                f'outliers.axes.{axis}', flagged, str(flagged), known=verdict.outliers.looked_for
            )
        )
    head = (
        'deg/s', 'bias', '+-', 'std raw at rest', f'std {method}', 'ratio',
        'changed in motion (rms)', 'outliers',
    )  # fmt: skip
    return table_of(head, rows)


def _comparison(verdicts: dict[str, Verdict]) -> str:
    """Return the main figures of each method."""
    rows = []
    for method, verdict in verdicts.items():
        ratio = verdict.rests.ratio
        quiet = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else float('nan')
        heard = [axis for axis in range(3) if not verdict.silent[axis]]
        outliers = verdict.outliers
        changed = float(max(verdict.change_in_motion[heard], default=np.nan))
        cells = (
            _cell('median_ratio', quiet, f'{quiet:.3f}'),
            _cell('largest_change', changed, f'{np.degrees(changed):.4f}'),
            _cell('heading.left', verdict.heading.left, per_minute(verdict.heading.left)),
            _cell('lagging', verdict.lagging, f'{100.0 * verdict.lagging:.0f} %'),
            _cell('outliers', outliers.samples, str(outliers.samples), known=outliers.looked_for),
        )
        rows.append(f'<th scope="row">{method}</th>{"".join(cells)}<td>{verdict.outcome}</td>')
    head = (
        'method', 'noise at rest, ratio', 'changed in motion (deg/s, rms)', 'drift left (deg/min)',
        'lags', 'outliers', 'outcome',
    )  # fmt: skip
    return table_of(head, rows)


def _provenance(recording: DrawnRecording) -> str:
    facts = ''.join(
        f'<dt>{text_of(what)}</dt><dd>{text_of(which)}</dd>' for what, which in recording.facts
    )
    default = Parameters()
    rows = []
    for name, description in FIELDS.items():
        value, standard = getattr(recording.parameters, name), getattr(default, name)
        changed = '' if value == standard else f'<strong>changed</strong>, else {_shown(standard)}'
        rows.append(
            f'<td>{text_of(description.name)}</td><td>{_shown(value)}</td><td>{changed}</td>'
        )
    table = table_of(('parameter', 'value', ''), rows, ' class="settings"')
    return (
        f'<h2>Where this comes from</h2><dl>{facts}</dl>'
        f'<details><summary>All parameters</summary>{table}</details>'
    )


def _shown(value: Any) -> str:
    many = isinstance(value, (tuple, list))
    return text_of(' '.join(f'{v:g}' for v in value) if many else str(value))


def _data(recording: DrawnRecording) -> dict[str, Any]:
    """Return what the figures have in common, and each without its panels, as JSON knows them."""
    return {
        'methods': list(recording.verdicts),
        'seconds': max(recording.seconds, 1e-9),
        'scale': _seconds_per_tick(recording),
        'rests': [[round(a, 3), round(b, 3)] for a, b in recording.rests],
        'figures': [
            {
                'name': figure.name,
                'x': figure.x,
                'y': figure.y,
                'inTime': figure.in_time,
                'logarithmic': figure.logarithmic,
                'limits': figure.limits,
            }
            for figure in recording.figures
        ],
    }


def _seconds_per_tick(recording: DrawnRecording) -> float:
    return max(recording.seconds, 1e-9) / _TICKS


def _packed_panels(figure: Figure, recording: DrawnRecording) -> list[dict[str, Any]]:
    scale = _seconds_per_tick(recording)
    return [
        {
            'name': name,
            'traces': [_packed(trace, scale, in_time=figure.in_time) for trace in traces],
        }
        for name, traces in figure.panels.items()
    ]


def _packed(trace: Trace, scale: float, *, in_time: bool) -> dict[str, Any]:
    out = {'role': trace.role, 'style': trace.style, 'y': _base64(trace.y, np.float32)}
    if in_time:
        ticks = np.clip(np.round(np.asarray(trace.x) / scale), 0, _TICKS)
        out['ticks'] = _base64(ticks, np.uint32)
    else:
        out['x'] = _base64(trace.x, np.float32)
    if trace.middle is not None:
        out['middle'] = _base64(trace.middle, np.float32)
    return out


def _base64(values: NDArray[Any], kind: type[np.generic]) -> str:
    little = np.asarray(values).astype(np.dtype(kind).newbyteorder('<'))
    return base64.b64encode(little.tobytes()).decode()
