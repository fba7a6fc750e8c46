"""Soft proofing of structural-colour prints: halftones, pictures of printed shapes, comparison of models."""
