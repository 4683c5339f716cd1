"""Where modules are found that once had another name.

What documents and examples named goes on working under its old name, with a `DeprecationWarning`. Everything else
fails, and the error names the new place.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.abc import Loader
else:
    Loader = object  # the real one would load a lot that the package alone does not need

# Old name, and new name, below the package's.
PUBLIC = {
    "assembly": "model.assembly",
    "cells": "generate.cells",
    "errors": "model.errors",
    "files": "formats.files",
    "geometry": "model.geometry",
    "plan": "model.plan",
    "profiles": "generate.profiles",
    "render": "pictures.renderer",
    "render_facts": "show.facts",
    "render_output": "pictures.output",
    "render_scene": "show.scene",
    "run": "planning.runs",
    "serialization": "formats.serialization",
    "sources": "formats.sources",
    "viewer_live": "viewer.live",
    "viewer_page": "page.standalone",
}
INTERNAL = {
    "bound_texts": "formats.bound_texts",
    "cli_compare": "cli.compare",
    "cli_compile": "cli.compile",
    "cli_demo": "cli.demo",
    "cli_generate": "cli.generate",
    "cli_inspect": "cli.inspect",
    "cli_kernels": "cli.kernels",
    "cli_output": "cli.output",
    "cli_plan": "cli.plan",
    "cli_plan_output": "cli.plan_output",
    "cli_render": "cli.render",
    "cli_report": "cli.report",
    "cli_reproduce": "cli.reproduce",
    "cli_train": "cli.train",
    "cli_verify": "cli.verify",
    "cli_view": "cli.view",
    "contact": "stability.contact",
    "documents": "formats.documents",
    "messages": "formats.messages",
    "profile_layout": "generate.profile_layout",
    "render_figures": "show.figures",
    "render_markup": "show.markup",
    "render_model": "pictures.model",
    "render_robot": "show.robot",
    "render_subject": "show.subject",
    "render_view": "show.view",
    "report_charts": "report.charts",
    "report_verification": "report.verification",
    "run_journal": "planning.run_journal",
    "schemas": "formats.schemas",
    "verification_checks": "verification.checks",
    "verification_model": "verification.model",
    "verification_physics": "verification.physics",
    "verification_replay": "verification.replay",
    "verification_report": "verification.report",
    "verification_support": "verification.support",
    "viewer_drawing": "viewer.drawing",
    "viewer_explain": "viewer.explain",
    "viewer_server": "viewer.server",
    "viewer_texts": "viewer.texts",
    "viewer_time": "show.playback",
}


class MovedModules:
    """Finds modules by their old names; asked only after the interpreter has found nothing of such a name."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """A specification that yields the module in its new place.

        Raises:
            ModuleNotFoundError: the module has moved, and its old name is no longer served.
        """
        package, _, name = fullname.partition(".")
        if package != "takeapart":
            return None
        if name in INTERNAL:
            raise ModuleNotFoundError(f"{fullname} is now takeapart.{INTERNAL[name]}", name=fullname)
        return ModuleSpec(fullname, _Alias(f"takeapart.{PUBLIC[name]}")) if name in PUBLIC else None


class _Alias(Loader):
    """Loads a module by handing out another one, which stays what it is."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.specification: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        warnings.warn(f"{spec.name} is now {self.name}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(self.name)
        self.specification = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.specification  # the interpreter has put that of the old name there


def serve_old_names() -> None:
    """Makes the old names known to the interpreter."""
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.append(MovedModules())
