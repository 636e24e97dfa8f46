"""What a package says of itself: its version, and the names that it hands on."""

from collections.abc import Mapping
from types import ModuleType

__version__ = "0.1.0"


def exported(names: Mapping[str, object]) -> list[str]:
    """Return the public names of a package's ``__init__``, for its ``__all__``.

    Parameters
    ----------
    names : mapping of str to object
        Its ``globals()``; modules, private names and those of other packages are left out.
    """
    return sorted(
        name
        for name, thing in names.items()
        if not (name.startswith("_") or isinstance(thing, ModuleType) or thing is exported)
        and getattr(thing, "__module__", "oed_sysid").startswith("oed_sysid")
    )
