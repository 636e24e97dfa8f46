"""Import paths of version 0.1."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.util import find_spec

import pytest

from oed_sysid.runtime.moved import MOVED, new_path


@pytest.mark.parametrize("old", MOVED)
def test_old_path_leads_to_the_module_that_has_its_names(old: str) -> None:
    """An old path is the new module itself, so that its classes are the same, and warns."""
    new = new_path(f"oed_sysid.{old}")
    assert new is not None
    sys.modules.pop(f"oed_sysid.{old}", None)
    with pytest.warns(DeprecationWarning, match=new):
        found = import_module(f"oed_sysid.{old}")
    assert found is import_module(new)


def test_modules_below_an_old_path_are_no_second_copies() -> None:
    """A class imported by its old path is the class of the package."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        old = import_module("oed_sysid.effects.base")
    assert old is import_module("oed_sysid.physics.base")


def test_what_never_was_is_not_found() -> None:
    """A path that no version had is no module."""
    with pytest.raises(ModuleNotFoundError):
        import_module("oed_sysid.nowhere")
    assert find_spec("oed_sysid.effects.nowhere") is None
