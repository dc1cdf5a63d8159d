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
    for argument in ('--headless=new', '--no-sandbox', '--disable-gpu', '--window-size=1200,900'):
        options.add_argument(argument)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    service = Service(programs[1], env=os.environ | {'SE_OFFLINE': 'true'})
    driver = webdriver.Chrome(options=options, service=service)
    try:
        yield driver
    finally:
        driver.quit()


def wait_for(condition):
    """Wait until a condition holds."""
    end = time.monotonic() + 120.0  # a busy machine starts a browser slowly
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def opened(browser, page):
    """Open a page and wait until it has drawn something."""
    for log in ('browser', 'performance'):  # of the page before
        browser.get_log(log)
    browser.get(page.as_uri())
    wait_for(lambda: browser.execute_script('return Number(document.body.dataset.drawn || 0)'))


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
