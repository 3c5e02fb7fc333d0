"""Simulator: scene -> photons -> electrons -> ADU. Folders follow the light; `chain.py` alone knows the order."""
