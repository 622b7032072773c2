"""Measured materials: tables of scattering read from files, and what the model is that comes nearest to them."""

from mrm_nodes.measured.fitting import Fit, fit, folds, leave_angles_out
from mrm_nodes.measured.measurement import Measurement
from mrm_nodes.measured.models import MODELS
from mrm_nodes.measured.reading import read
from mrm_nodes.measured.xompt import write_xompt

__all__ = ["MODELS", "Fit", "Measurement", "fit", "folds", "leave_angles_out", "read", "write_xompt"]
