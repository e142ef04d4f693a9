"""The demo of the page's tests, one for a module, and their browser, one for all."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Playwright, sync_playwright

from tactable.rig.ready import cached_table
from tactable.shipped import find_device
from tests.precompute.builder.test_table_build import SMALL
from tests.system.page import CHROMIUM, Demo
from tests.tactable.click_table import build_click_table
from tests.tools.once import once_a_run


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small bar and its table."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    (folder / "tactable").mkdir()
    table = once_a_run(tmp_path_factory, "clicks", build_click_table) / "bar.nc"
    shutil.copy(table, cached_table(find_device(str(folder / "small.toml")), folder / "tactable"))
    return folder


@pytest.fixture(scope="module")
def demo(demo_folder: Path) -> Iterator[Demo]:
    demo = Demo(demo_folder)
    yield demo
    demo.stop()


@pytest.fixture(scope="package")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as started:
        yield started


@pytest.fixture(scope="package")
def browser(playwright: Playwright) -> Iterator[Browser]:
    # As root, which a container often is, Chromium has no sandbox of its own.
    words = ["--no-sandbox"] if os.geteuid() == 0 else []
    chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=words)
    yield chromium
    chromium.close()
