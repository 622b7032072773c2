"""The float64 evaluator: what the papers say, for arrays of any shape."""

from .bsdf import BsdfSample, Conductor, Dielectric, GeneralizedSchlick
from .fresnel import fresnel_conductor, fresnel_dielectric, fresnel_schlick

__all__ = [
    "BsdfSample",
    "Conductor",
    "Dielectric",
    "GeneralizedSchlick",
    "fresnel_conductor",
    "fresnel_dielectric",
    "fresnel_schlick",
]
