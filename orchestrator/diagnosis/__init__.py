"""Where the model fails, which physical effect is missing, and by how much the error falls when it is added.

The method is a weak form of the voltage equation: R_s, a co-energy map and the effects' parameters are fitted to
windowed integrals of the record, whitened by the sensors' own noise. Effects are arguments; none is known by name.
"""

from orchestrator.diagnosis._compare import bare_model_step, compare_recording, model_step
from orchestrator.diagnosis._diagnose import Diagnosis, diagnose_recording
from orchestrator.diagnosis._known import KnownEffects, inseparable_groups
from orchestrator.diagnosis._refit import add_effects, remove_effect
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION, require_known
from orchestrator.diagnosis.fitting.guarded import guarded
from orchestrator.diagnosis.fitting.simulation import simulated_current
from orchestrator.diagnosis.fitting.workers import workers_here
from orchestrator.diagnosis.judgement.judge import judge
from orchestrator.diagnosis.reporting.diagnosis_file import SavedDiagnosis, load_diagnosis, save_diagnosis
from orchestrator.diagnosis.reporting.explanation import explanation_of, model_changes, removed_effects
from orchestrator.diagnosis.reporting.keeping import diagnose_and_keep
from orchestrator.diagnosis.reporting.motor_model import flux_map_of
from orchestrator.diagnosis.reporting.pictures import diagnosis_step
from orchestrator.diagnosis.reporting.words import in_words
from orchestrator.diagnosis.selection.first_models import ModelChoice
from orchestrator.diagnosis.selection.search_state import InterimResult
from orchestrator.diagnosis.weak_form.magnetics import Magnetics, linear_magnetics

__all__ = [
    "CROSS_SATURATION",
    "SATURATION",
    "Criteria",
    "Diagnosis",
    "InterimResult",
    "KnownEffects",
    "Magnetics",
    "ModelChoice",
    "SavedDiagnosis",
    "add_effects",
    "bare_model_step",
    "compare_recording",
    "diagnose_and_keep",
    "diagnose_recording",
    "diagnosis_step",
    "explanation_of",
    "flux_map_of",
    "guarded",
    "in_words",
    "inseparable_groups",
    "judge",
    "linear_magnetics",
    "load_diagnosis",
    "model_changes",
    "model_step",
    "remove_effect",
    "removed_effects",
    "require_known",
    "save_diagnosis",
    "simulated_current",
    "workers_here",
]
