"""A run directory with plausible contents, for the report's tests: written through the project's own writers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orchestrator.estimation import save_flux_map
from orchestrator.recording import SegmentWriter
from orchestrator.runs import RunDirectory
from protocols import (
    AxisPercent,
    Basis,
    Capabilities,
    Capture,
    EstimationReport,
    FluxMap,
    InductanceRange,
    JournalledMessage,
    LockChecked,
    MapChecks,
    MapReport,
    Note,
    PointDone,
    Procedure,
    Remark,
    ResistanceEstimate,
    ResistanceEstimated,
    ResistanceReading,
    RunEnded,
    RunStarted,
    Segment,
    SegmentStage,
    StageStarted,
    StateChanged,
)

FS = 1000.0
MAGNET_WB = 0.3


BASES = {"classical": Basis.INTEGRATION, "injection": Basis.INJECTION, "energy": Basis.ENERGY}


def a_map(method: str, scale: float = 1.0, step_a: float = 0.5) -> FluxMap:
    """Saturation and cross-saturation from one co-energy, so that the map is reciprocal; NaN in the corners."""
    axis = np.arange(-3.0, 3.0 + step_a / 2, step_a)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    grids = {
        "psi_d": MAGNET_WB + scale * (0.043 * d - 1.2e-3 * d**2 - 4e-4 * d**3 - 6e-4 * q**2),
        "psi_q": scale * (0.069 * q - 1.0e-3 * q**3 - 1.2e-3 * d * q),
        "l_dd": scale * (0.043 - 2.4e-3 * d - 1.2e-3 * d**2),
        "l_dq": scale * -1.2e-3 * q,
        "l_qq": scale * (0.069 - 3e-3 * q**2 - 1.2e-3 * d),
    }
    outside = np.hypot(d, q) > 3.6
    values = {name: np.where(outside, np.nan, grid) for name, grid in grids.items()}
    stds = {f"{name}_std": np.where(outside, np.nan, 4e-4 + 1e-4 * np.hypot(d, q)) for name in grids}
    return FluxMap(method=method, basis=BASES.get(method), i_d=axis, i_q=axis, **values, **stds)


def a_resistance() -> ResistanceEstimate:
    """Readings that rise with the winding's heat."""
    readings = tuple(
        ResistanceReading(start_s=12.0 * k, value_ohm=4.31 + 0.25 * (1 - np.exp(-k / 6)), std_ohm=0.012)
        for k in range(14)
    )
    return ResistanceEstimate(value_ohm=4.47, low=4.455, high=4.485, first_ohm=4.31, last_ohm=4.54, readings=readings)


def a_run_directory(path: Path, motor: str = "400 W test PMSM", ended: bool = True) -> Path:
    """A finished run with everything that a report can show."""
    run = RunDirectory.create(path, a_procedure(motor), CAPABILITIES)
    segments = [_classical(path, k, axis, held) for k, (axis, held) in enumerate(CLASSICAL)]
    segments += [_injection(path, k, point) for k, point in enumerate(POINTS)]
    with run.lock():
        for message in _messages(path, segments, ended):
            run.journal.append(message)
    run.write_manifest()
    results = path / "results"
    results.mkdir()
    save_flux_map(results / "flux_map.nc", a_map("injection"), motor=motor)
    save_flux_map(results / "flux_map_classical.nc", a_map("classical", 1.03), motor=motor)
    (results / "estimates.json").write_text(a_report().model_dump_json(indent=2), encoding="utf-8")
    return path


def a_report() -> EstimationReport:
    return EstimationReport(
        resistance=ResistanceEstimate(value_ohm=4.47, low=4.455, high=4.485, first_ohm=4.31, last_ohm=4.54),
        method="injection",
        crossings=AxisPercent(d_percent=0.42, q_percent=1.17),
        parity=AxisPercent(d_percent=0.31, q_percent=0.88),
        reciprocity_percent=0.66,
        classical_against_injection_percent=2.4,
        usable=True,
        remarks=(Remark(code="classical.loop_open", text="classical: the loop is open by 1.1 mWb near zero current"),),
        maps={
            "injection": MapReport(
                basis=Basis.INJECTION,
                checks=MapChecks(
                    crossings=AxisPercent(d_percent=0.42, q_percent=1.17),
                    parity=AxisPercent(d_percent=0.31, q_percent=0.88),
                    reciprocity_percent=0.66,
                ),
                inductances=InductanceRange(
                    l_dd_low_h=0.025, l_dd_high_h=0.0442, l_qq_low_h=0.042, l_qq_high_h=0.0726, l_dq_largest_h=0.0036
                ),
            ),
            "classical": MapReport(basis=Basis.INTEGRATION, checks=MapChecks()),
        },
        files={"flux_map": "results/flux_map.nc"},
    )


def a_procedure(motor: str) -> Procedure:
    return Procedure.model_validate(
        {
            "format": "fluxbench-procedure",
            "version": 1,
            "name": "example",
            "motor": {
                "name": motor,
                "pole_pairs": 2,
                "rated_current_rms_a": 1.66,
                "stator_resistance_ohm": 4.25,
                "d_inductance_h": 0.04325,
                "q_inductance_h": 0.06905,
                "pm_flux_wb": MAGNET_WB,
            },
            "drive": {"name": "simulated"},
            "limits": {"current_a": 3.6, "voltage_v": 200.0},
            "stages": [{"kind": "classical"}, {"kind": "injection"}, {"kind": "estimate"}],
        }
    )


CAPABILITIES = Capabilities(
    name="example",
    sampling_frequency_hz=FS,
    pwm_frequency_hz=FS,
    pwm_frequencies_hz=(FS,),
    dc_bus_voltage_v=540.0,
    max_current_a=6.0,
    max_voltage_v=300.0,
    excitations=frozenset({"hold"}),
    watchdog_s=0.2,
    watchdog_covers=frozenset({"hold"}),
)
CLASSICAL = [("q", held) for held in (-3.0, -1.5, 0.0, 1.5, 3.0)] + [("d", held) for held in (-3.0, 0.0, 3.0)]
POINTS = [(d, q) for d in np.arange(-3.0, 3.1, 0.75) for q in np.arange(-3.0, 3.1, 0.75) if np.hypot(d, q) <= 3.6]


def _classical(path: Path, number: int, axis: str, held: float) -> Segment:
    t = np.arange(int(2 * FS)) / FS
    swept = 3.0 * np.interp(t / 2.0 % 1, [0, 0.125, 0.375, 0.625, 0.875, 1], [0, 1, 1, -1, -1, 0])
    swept = np.sign(swept) * np.minimum(np.abs(swept), np.sqrt(3.6**2 - held**2))
    constant = np.full_like(swept, held) + 0.02 * np.sin(6 * t)
    i_dq = np.stack([constant, swept] if axis == "q" else [swept, constant], axis=1)
    settings = {"swept_axis": axis, "held_a": held, "period_s": 2.0, "periods": 1}
    return _written(path, f"classical-{number:03d}", SegmentStage.CLASSICAL, 10.0 * number, i_dq, settings)


def _injection(path: Path, number: int, point: tuple[float, float]) -> Segment:
    i_dq = np.tile(point, (50, 1)).astype(np.float64)
    return _written(path, f"injection-{number:03d}", SegmentStage.INJECTION, 100.0 + number, i_dq, {})


def _written(
    path: Path, name: str, stage: SegmentStage, start_s: float, i_ab: np.ndarray, settings: dict[str, object]
) -> Segment:
    capture = Capture(
        start_s=start_s, sampling_frequency_hz=FS, i_ab=i_ab, v_ab=4.0 * i_ab, v_dc=np.full(len(i_ab), 540.0)
    )
    with SegmentWriter(path, name) as writer:
        writer.append(capture)
        written = writer.finish()
    return Segment(
        id=name, stage=stage, start_s=start_s, samples=written.samples, settings=settings, sha256=written.sha256
    )


def _messages(path: Path, segments: list[Segment], ended: bool) -> list[JournalledMessage]:
    procedure = a_procedure("x")
    done = [
        PointDone(
            id=segment.id,
            stage_index=0,
            segment=segment,
            achieved_d_a=float(POINTS[k - len(CLASSICAL)][0]) * 0.99 + 0.01 if k >= len(CLASSICAL) else 0.0,
            achieved_q_a=float(POINTS[k - len(CLASSICAL)][1]) * 0.98 if k >= len(CLASSICAL) else 0.0,
            points_done=k + 1,
            points=len(segments),
            seconds_left=0.0,
        )
        for k, segment in enumerate(segments)
    ]
    start = RunStarted(
        run=str(path),
        name="example",
        motor=procedure.motor,
        limits=procedure.limits,
        drive="simulated",
        stages=8,
        points=len(segments),
        points_done=0,
        seconds=300.0,
    )
    verdict = "locked: moved 0.0004 rad (tolerance 0.02), 99.9 % sure"
    return [
        start,
        StateChanged(source="idle", target="connecting"),
        LockChecked(
            locked=True, confidence=0.999, moved_rad=4e-4, moved_std_rad=2e-4, twist_rad=0.004, summary=verdict
        ),
        StageStarted(index=0, stage="classical", title="classical sweep", points=len(CLASSICAL)),
        StateChanged(source="connecting", target="sweeping_classical"),
        *done,
        Note(level="warning", text="the bus sagged by 2 % at point injection-012"),
        StateChanged(source="sweeping_injection", target="stopping", reason="computing needs no current"),
        ResistanceEstimated(estimate=a_resistance()),
        *([RunEnded(outcome="finished", reason="every stage is done", run=str(path))] if ended else []),
    ]
