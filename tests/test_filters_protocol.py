"""A user's own filter: the protocol, and how it is found."""

import types

import pytest

from insemu.errors import InputError
from insemu.filters import LooselyCoupledEKF, NavigationFilter, protocol, user_filter
from tests.filter_cases import DT, MODEL_15


class Mine:
    def __init__(self, belief, dt, **keywords):
        self.inner = LooselyCoupledEKF(belief, dt)

    def run(self, imu, gnss, initial, initial_sigma):
        return self.inner.run(imu, gnss, initial, initial_sigma)


def offer(monkeypatch, **classes):
    entries = [types.SimpleNamespace(name=n, value=f"mine:{n}", load=lambda c=c: c) for n, c in classes.items()]
    monkeypatch.setattr(protocol, "entry_points", lambda group: entries)


def test_the_own_filter_and_a_users_are_filters(monkeypatch):
    assert isinstance(LooselyCoupledEKF(MODEL_15, DT), NavigationFilter)
    offer(monkeypatch, mine=Mine)
    assert isinstance(user_filter("mine")(MODEL_15, DT), NavigationFilter)


def test_what_is_not_there_or_not_a_filter_is_said(monkeypatch):
    with pytest.raises(InputError, match="installed packages offer them under"):
        user_filter("mine")
    offer(monkeypatch, mine=Mine, broken=object)
    with pytest.raises(InputError, match="did you mean 'mine'"):
        user_filter("mina")
    with pytest.raises(InputError, match="has no method run"):
        user_filter("broken")
