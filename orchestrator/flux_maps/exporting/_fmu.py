"""The machine as a functional mock-up unit: FMI 2.0 co-simulation (https://fmi-standard.org), the C header inside.

It is compiled where there is a C compiler, for Linux, and always contains its sources. Decides no content.
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import zipfile
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.sax.saxutils import quoteattr

from orchestrator.flux_maps.exporting._c_header import c_float_file
from orchestrator.flux_maps.exporting._products import FileContent, Products
from protocols import InputError

_COMPILERS = ("cc", "gcc", "clang")
_VARIABLES = (
    ("v_d", "input", "V", "voltage along d"),
    ("v_q", "input", "V", "voltage along q"),
    ("w_e", "input", "rad/s", "electrical speed"),
    ("R_s", "parameter", "Ohm", "stator resistance"),
    ("i_d", "output", "A", "current along d"),
    ("i_q", "output", "A", "current along q"),
    ("torque", "output", "N.m", "torque 3/2 n (psi_d i_q - psi_q i_d)"),
    ("psi_d", "output", "Wb", "flux linkage along d"),
    ("psi_q", "output", "Wb", "flux linkage along q"),
)
"""Variables in the order of their value references: name, causality, unit, meaning."""


def fmu_file(products: Products) -> FileContent:
    """`machine.fmu`: v_d, v_q and electrical speed in, currents, torque and fluxes out; starts at zero current.

    Raises
    ------
    InputError
        Where R_s is unknown, or zero current was not measured.
    """
    resistance, rest = products.motor.stator_resistance_ohm, products.rest_wb
    if resistance is None or rest is None:
        raise InputError("fmu", "stator_resistance_ohm", "a machine that runs needs R_s, and zero current in its map")
    header = c_float_file(products)
    source = (files(__package__) / "machine_fmu.c.txt").read_text(encoding="utf-8")
    guid = hashlib.sha256(header.content).hexdigest()[:32]
    values = {"SYMBOL": products.symbol, "GUID": guid, "POLE_PAIRS": str(products.motor.pole_pairs)}
    values |= {"R_S": f"{resistance:.17g}", "PSI_M": f"{rest:.17g}"}
    for name, value in values.items():
        source = source.replace(f"@{name}@", value)
    content = {f"sources/{products.symbol}.c": source.encode(), "sources/flux_map.h": header.content}
    binary = _compile(source.encode(), header.content)
    folder = "linux64" if platform.machine() == "x86_64" else f"{platform.machine()}-linux"
    if binary is not None:
        content[f"binaries/{folder}/{products.symbol}.so"] = binary
    content["modelDescription.xml"] = _description(products, guid, resistance).encode()
    note = f"compiled for {folder}" if binary is not None else "no C compiler is available: sources only"
    return FileContent(_zipped(content), header.measured_percent, header.filled_nodes, (*header.notes, note))


def _compile(source: bytes, header: bytes) -> bytes | None:
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None or platform.system() != "Linux":
        return None
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "machine.c").write_bytes(source)
        (folder / "flux_map.h").write_bytes(header)
        call = [compiler, "-shared", "-fPIC", "-O2", "-std=c99", "-fvisibility=hidden", "machine.c", "-o", "machine.so"]
        try:
            subprocess.run(call, cwd=folder, check=True, capture_output=True, timeout=60)
        except (OSError, subprocess.SubprocessError):
            return None
        return (folder / "machine.so").read_bytes()


def _description(products: Products, guid: str, resistance: float) -> str:
    lines = []
    for reference, (name, causality, unit, meaning) in enumerate(_VARIABLES):
        start = {"input": ' start="0"', "parameter": f' start="{resistance:.17g}"'}.get(causality, "")
        variability = "fixed" if causality == "parameter" else "continuous"
        lines.append(
            f'    <ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}" description={quoteattr(meaning)}>'
            f'<Real unit="{unit}"{start}/></ScalarVariable>'
        )
    outputs = [k for k, variable in enumerate(_VARIABLES, start=1) if variable[1] == "output"]
    unknowns = "".join(f'<Unknown index="{k}"/>' for k in outputs)
    units = "".join(f'<Unit name="{unit}"/>' for unit in dict.fromkeys(variable[2] for variable in _VARIABLES))
    summary = f"{products.motor.name}; recording {products.recording or 'unknown'}; {'; '.join(products.notes)}"
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{products.symbol}" guid="{guid}" description={quoteattr(summary)}
    generationTool="fluxbench" variableNamingConvention="flat" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{products.symbol}" canHandleVariableCommunicationStepSize="true">
    <SourceFiles><File name="{products.symbol}.c"/></SourceFiles>
  </CoSimulation>
  <UnitDefinitions>{units}</UnitDefinitions>
  <ModelVariables>
{chr(10).join(lines)}
  </ModelVariables>
  <ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


def _zipped(content: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
