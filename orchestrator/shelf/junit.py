"""Judged runs as JUnit XML, for programs that collect the results of tests."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from orchestrator.recording import replace_file
from orchestrator.shelf.station import JudgedRun

_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(file: Path, runs: Sequence[JudgedRun]) -> None:
    """Replace a file by the results of runs; raises `StorageError`.

    A suite is a run, and a case one of its quantities with a limit. A run without limits has one case: that it
    finished.
    """
    root = ET.Element("testsuites", name="fluxbench")
    for run in runs:
        _add_suite(root, run)
    ET.indent(root)
    replace_file(file, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _add_suite(root: ET.Element, run: JudgedRun) -> None:
    facts, reasons = run.facts, () if run.acceptance is None else run.acceptance.reasons
    failures = sum(not reason.passed for reason in reasons)
    errors = int(facts.outcome != "finished")
    suite = ET.SubElement(root, "testsuite", name=_clean(facts.serial or facts.run))
    suite.attrib |= {"tests": str(len(reasons) or 1), "failures": str(failures), "errors": str(errors)}
    suite.attrib |= {"time": f"{facts.duration_s or 0.0:.3f}", "timestamp": _clean(facts.created.removesuffix("Z"))}
    properties = ET.SubElement(suite, "properties")
    texts = {"run": str(run.folder), "motor": facts.motor, "serial": facts.serial, "drive": facts.drive}
    for name, value in {**texts, "verdict": facts.verdict, "label": run.label}.items():
        ET.SubElement(properties, "property", name=name, value=_clean(value))
    class_name = _clean(f"{facts.procedure}.{facts.serial or facts.run}")
    for reason in reasons:
        case = ET.SubElement(suite, "testcase", classname=class_name, name=reason.quantity)
        if reason.passed:
            ET.SubElement(case, "system-out").text = _clean(reason.sentence)
        else:
            ET.SubElement(case, "failure", message=_clean(reason.sentence))
    if not reasons:
        case = ET.SubElement(suite, "testcase", classname=class_name, name="finished")
        if errors:
            ET.SubElement(case, "error", message=_clean(f"the run ended: {facts.outcome or facts.problem}"))


def _clean(text: str) -> str:
    """A text without the characters that XML 1.0 forbids."""
    return _NOT_IN_XML.sub("?", text)
