"""The service runs with or without its page."""

from contextlib import ExitStack
from typing import Any

import pytest

from orbitfb.app.service import page_process
from orbitfb.app.setup.startup import announcement
from orbitfb.config.tree import AppConfig
from orbitfb.physics.places import Ring


def started(config: AppConfig) -> page_process.PageProcess:
    nothing: Any = None
    with ExitStack() as stack:
        return page_process.PageProcess(config, Ring.load().channels("x"), nothing, stack)


def test_without_the_extra_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        page_process, "find_spec", lambda name: None if name == "uvicorn" else object()
    )
    page = started(AppConfig())
    assert page.where == ""
    assert "(uvicorn)" in page.problem and "pip install 'orbitfb[web]'" in page.problem
    where = {"addresses": "h", "port": 1, "metrics": "", "data": "d", "page": ""}
    where |= {"policy": "svd", "policy_reason": "the baseline"}
    lines = list(announcement({**where, "page_problem": page.problem}, False))
    assert f"no operator page: {page.problem}" in lines


def test_nothing_is_said_where_it_is_not_wanted():
    config = AppConfig().model_copy(
        update={"web": AppConfig().web.model_copy(update={"enabled": False})}
    )
    page = started(config)
    assert (page.where, page.problem) == ("", "")


@pytest.mark.parametrize(
    ("host", "shown"),
    [
        ("127.0.0.1", "http://127.0.0.1:5/"),
        ("0.0.0.0", "http://127.0.0.1:5/"),
        ("::", "http://[::1]:5/"),
        ("::1", "http://[::1]:5/"),
        ("fe80::2", "http://[fe80::2]:5/"),
        ("ring", "http://ring:5/"),
    ],
)
def test_the_address_is_one_that_a_browser_takes(host: str, shown: str):
    assert page_process._address(host, 5) == shown
