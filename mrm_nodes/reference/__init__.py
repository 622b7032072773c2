"""The float64 evaluator: what the papers say, for arrays of any shape."""

from .bsdf import BsdfSample, Conductor, Dielectric, GeneralizedSchlick, Lobe
from .diffuse import diffuse_microfacets, eon, lambert, oren_nayar
from .distributions import GGX, Beckmann, BeckmannRational, Distribution, distribution
from .energy import average_albedo, white_albedo
from .fresnel import fresnel_conductor, fresnel_dielectric, fresnel_schlick
from .materialx import Add, Closure, Lambert, Layer, Leaf, Mix, Multiply, OrenNayar
from .phong import Phong

__all__ = [
    "GGX",
    "Add",
    "Beckmann",
    "BeckmannRational",
    "BsdfSample",
    "Closure",
    "Conductor",
    "Dielectric",
    "Distribution",
    "GeneralizedSchlick",
    "Lambert",
    "Layer",
    "Leaf",
    "Lobe",
    "Mix",
    "Multiply",
    "OrenNayar",
    "Phong",
    "average_albedo",
    "diffuse_microfacets",
    "distribution",
    "eon",
    "fresnel_conductor",
    "fresnel_dielectric",
    "fresnel_schlick",
    "lambert",
    "oren_nayar",
    "white_albedo",
]
