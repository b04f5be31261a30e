from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from orchestrator.flux_maps import MapSurface
from orchestrator.flux_maps.exporting import export_map, invert, mtpa
from protocols import FluxMap, Motor
from tests.orchestrator.flux_maps.exporting.machines import MOTOR, POLE_PAIRS, Array, saturated_map
from tests.support.close import assert_close

GCC = ["gcc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
CURRENTS = np.array([[0.0, 0.0], [0.83, -1.37], [-2.1, 1.1], [1.55, 2.05], [-0.05, 2.95], [0.4, -0.4]])

FLOAT_PROGRAM = """\
#include <stdio.h>
#include "flux_map.h"
int main(void)
{
    float a, b;
    while (scanf("%f %f", &a, &b) == 2) {
        const float d = pm400_psi_d(a, b), q = pm400_psi_q(a, b);
        printf("%.9g %.9g %.9g %.9g %.9g %.9g\\n", (double)d, (double)q, (double)pm400_i_d(d, q),
            (double)pm400_i_q(d, q), (double)pm400_l_dd(a, b), (double)pm400_mtpa_i_d(b));
    }
    return 0;
}
"""

Q15_PROGRAM = """\
#include <stdio.h>
#include "flux_map_q15.h"
int main(void)
{
    int a, b;
    while (scanf("%d %d", &a, &b) == 2) {
        const int16_t d = pm400_q15_psi_d((int16_t)a, (int16_t)b), q = pm400_q15_psi_q((int16_t)a, (int16_t)b);
        printf("%d %d %d %d %d %d\\n", d, q, pm400_q15_i_d(d, q), pm400_q15_i_q(d, q),
            pm400_q15_l_dd((int16_t)a, (int16_t)b), pm400_q15_mtpa_i_d((int16_t)b));
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FluxMap]:
    folder, flux_map = tmp_path_factory.mktemp("headers"), saturated_map()
    export_map(flux_map, MOTOR, folder, ["c", "c-q15"])
    return folder, flux_map


def run(folder: Path, program: str, rows: list[str]) -> Array:
    """Compile with every warning an error, feed it rows, read the numbers it prints."""
    (folder / "main.c").write_text(program)
    subprocess.run([*GCC, "main.c", "-o", "main"], cwd=folder, check=True, capture_output=True, timeout=60)
    done = subprocess.run(
        [folder / "main"], input="\n".join(rows), capture_output=True, text=True, check=True, timeout=10
    )
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])


def defined(header: Path, name: str) -> float:
    found = re.search(rf"#define {name} \(?([-0-9.e+]+)f?\)?", header.read_text())
    assert found is not None, name
    return float(found[1])


def table(folder: Path, name: str) -> Array:
    """A table's numbers, in the order in which the file has them."""
    text = next(p.read_text() for p in folder.glob("*.h") if f" {name}[" in p.read_text())
    body = text.split(f" {name}[", 1)[1]
    shape = tuple(int(n) for n in re.findall(r"(\d+)\]", body.split("=", 1)[0]))
    numbers = re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", body.split("=", 1)[1].split(";", 1)[0])
    return np.array([float(n) for n in numbers]).reshape(shape)


def expected(flux_map: FluxMap) -> Array:
    """What linear lookups in the same tables give, in double precision."""
    surface, inverse = MapSurface(flux_map), invert(flux_map)
    psi = np.stack(
        [RegularGridInterpolator((flux_map.i_d, flux_map.i_q), t)(CURRENTS) for t in surface.filled], axis=-1
    )
    currents = [RegularGridInterpolator((inverse.psi_d, inverse.psi_q), t)(psi) for t in inverse.filled()]
    return np.column_stack((psi, *currents))


def test_float_lookups_are_the_tables_linear_interpolation(exported: tuple[Path, FluxMap]) -> None:
    folder, flux_map = exported
    found = run(folder, FLOAT_PROGRAM, [f"{d} {q}" for d, q in CURRENTS])
    np.testing.assert_allclose(found[:, :2], expected(flux_map)[:, :2], atol=2e-7)
    np.testing.assert_allclose(found[:, 2:4], expected(flux_map)[:, 2:4], atol=2e-5)
    np.testing.assert_allclose(found[:, 2:4], CURRENTS, atol=0.02)


def test_fixed_point_lookups_are_within_two_counts_of_it(exported: tuple[Path, FluxMap]) -> None:
    folder, flux_map = exported
    header = folder / "flux_map_q15.h"
    amperes = defined(header, "PM400_Q15_CURRENT_SCALE_A") / 32768.0
    webers = defined(header, "PM400_Q15_FLUX_SCALE_WB") / 32768.0
    counts = np.round(CURRENTS / amperes).astype(int)
    found = run(folder, Q15_PROGRAM, [f"{d} {q}" for d, q in counts])
    truth = expected(flux_map)
    np.testing.assert_allclose(found[:, :2] * webers, truth[:, :2], atol=2 * webers)
    np.testing.assert_allclose(found[:, 2:4] * amperes, truth[:, 2:4], atol=8 * amperes)
    henries = defined(header, "PM400_Q15_INDUCTANCE_SCALE_H") / 32768.0
    np.testing.assert_allclose(found[0, 4] * henries, 0.043, atol=2 * henries)


def test_lookups_stop_at_the_ends_of_the_axes(exported: tuple[Path, FluxMap]) -> None:
    folder, _ = exported
    beyond = run(folder, FLOAT_PROGRAM, ["90 0.5", "3 0.5", "0.5 -90", "0.5 -3"])
    np.testing.assert_array_equal(beyond[0], beyond[1])
    np.testing.assert_array_equal(beyond[2], beyond[3])
    fixed = run(folder, Q15_PROGRAM, ["32767 100", "-32768 100", "100 32767", "100 -32768"])
    assert (np.abs(fixed) <= 32768).all()


def test_mtpa_in_the_header_is_the_maps(exported: tuple[Path, FluxMap]) -> None:
    folder, flux_map = exported
    last = defined(folder / "flux_map.h", "PM400_MTPA_CURRENT_STEP_A") * 32
    curve = mtpa(flux_map, POLE_PAIRS, np.linspace(0.0, last, 33))
    assert_close(table(folder, "pm400_mtpa_i_q_table"), curve.i_dq[:, 1], 2.0**-23)
    assert curve.interior.all()


def test_rows_are_nodes_of_the_first_axis(exported: tuple[Path, FluxMap]) -> None:
    folder, flux_map = exported
    assert_close(table(folder, "pm400_psi_d_table"), MapSurface(flux_map).filled[0], 2.0**-23)


def test_masks_tell_measured_from_continued(exported: tuple[Path, FluxMap]) -> None:
    folder, flux_map = exported
    np.testing.assert_array_equal(table(folder, "pm400_measured_i"), np.isfinite(flux_map.psi_d))
    np.testing.assert_array_equal(table(folder, "pm400_measured_psi"), invert(flux_map).measured)


def test_every_fixed_point_entry_is_within_half_a_count(exported: tuple[Path, FluxMap]) -> None:
    folder, _ = exported
    scale = defined(folder / "flux_map_q15.h", "PM400_Q15_FLUX_SCALE_WB")
    counts = table(folder, "pm400_q15_psi_q_table")
    np.testing.assert_allclose(counts * scale / 32768, table(folder, "pm400_psi_q_table"), atol=0.51 * scale / 32768)


def test_both_headers_go_into_one_program_twice(exported: tuple[Path, FluxMap]) -> None:
    includes = '#include "flux_map.h"\n#include "flux_map_q15.h"\n' * 2
    assert run(exported[0], includes + "int main(void) { return 0; }\n", []).size == 0


def test_a_motors_name_cannot_end_the_comment(tmp_path: Path) -> None:
    motor = Motor(name="*/ int x; /* Ω", pole_pairs=2, pm_flux_wb=0.3)
    export_map(saturated_map(nodes=9), motor, tmp_path, ["c"])
    assert run(tmp_path, '#include "flux_map.h"\nint main(void) { return 0; }\n', []).size == 0
