"""Whole surfaces made retroreflective: OpenPBR, glTF, Standard Surface, and the documents that use them."""

from mrm_nodes.substitution import Surface, known_surfaces, retrofit, surface_documents

__all__ = ["Surface", "known_surfaces", "retrofit", "surface_documents"]
