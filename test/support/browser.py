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

"""The system's Chromium without a window, and what a page did in it."""

import json
import os
import shutil
import time
from contextlib import contextmanager

import pytest

ARGUMENTS = (
    '--headless=new',
    '--no-sandbox',
    '--disable-gpu',
    '--window-size=1200,900',
    # A container may have little shared memory, which ROS 2 uses as well.
    '--disable-dev-shm-usage',
    # A page that is taken for one in the background gets no frames, and so never learns what is in
    # sight.
    '--disable-background-timer-throttling',
    '--disable-backgrounding-occluded-windows',
    '--disable-renderer-backgrounding',
)
# What a page shows of itself where something that was waited for did not come.
STATE = (
    'return {visibility: document.visibilityState, ready: document.readyState, at: scrollY, '
    'drawn: [...document.querySelectorAll(".plot")].map((node) => Boolean(node.drawn))}'
)


@contextmanager
def chromium():
    """Yield the system's Chromium, or skip."""
    programs = [shutil.which(name) for name in ('chromium', 'chromedriver')]
    if None in programs:
        pytest.skip('there is no Chromium: apt-get install chromium chromium-driver')
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for argument in ARGUMENTS:
        options.add_argument(argument)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    service = Service(programs[1], env=os.environ | {'SE_OFFLINE': 'true'})
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield driver
    finally:
        driver.quit()


def wait_for(browser, condition):
    """Wait until a condition holds in the page that is open."""
    begin = time.monotonic()
    while not condition():
        waited = time.monotonic() - begin
        # A busy machine starts a browser slowly.
        assert waited < 120.0, (browser.execute_script(STATE), browser.get_log('browser'))
        if waited > 1.0:
            # A browser without a window may put its next frame off for ever; a picture needs one.
            browser.get_screenshot_as_png()
        time.sleep(0.02)


def opened(browser, page):
    """Open a page and wait until it has drawn something."""
    for log in ('browser', 'performance'):  # of the page before
        browser.get_log(log)
    browser.get(page.as_uri())
    wait_for(
        browser, lambda: browser.execute_script('return Number(document.body.dataset.drawn || 0)')
    )


def check_quiet(browser, page):
    """Nothing was said on the console, and nothing asked for but the page itself."""
    assert browser.get_log('browser') == []
    events = [json.loads(entry['message'])['message'] for entry in browser.get_log('performance')]
    asked = [
        event['params']['request']['url']
        for event in events
        if event['method'] == 'Network.requestWillBeSent'
    ]
    left = [url for url in asked if not url.startswith(('data:', 'blob:'))]
    assert set(left) <= {page.as_uri()}
