"""The float64 evaluator: what the papers say, for arrays of any shape."""

from .bsdf import BsdfSample, Conductor, Dielectric, GeneralizedSchlick
from .diffuse import eon, lambert
from .distributions import GGX, Beckmann, BeckmannRational
from .energy import average_albedo, white_albedo
from .fresnel import fresnel_conductor, fresnel_dielectric, fresnel_schlick

__all__ = [
    "GGX",
    "Beckmann",
    "BeckmannRational",
    "BsdfSample",
    "Conductor",
    "Dielectric",
    "GeneralizedSchlick",
    "average_albedo",
    "eon",
    "fresnel_conductor",
    "fresnel_dielectric",
    "fresnel_schlick",
    "lambert",
    "white_albedo",
]
