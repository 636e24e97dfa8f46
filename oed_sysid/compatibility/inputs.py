"""Inputs against the nominal model (placeholder until the next commit)."""
from __future__ import annotations
def input_findings(dataset, model, fixes, faults):
    return []
