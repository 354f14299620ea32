"""Measurements: what is claimed is measured here."""
