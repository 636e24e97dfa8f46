from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ProblemCatalogueHook(BuildHookInterface):
    """Put problems/ inside the wheel, where `load_problem` finds it by name."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version != "editable" and (Path(self.root) / "problems").is_dir():
            build_data["force_include"]["problems"] = "oed_sysid/_problems"
