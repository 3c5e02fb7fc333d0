"""Files of a run: atomic writes, tables, frames, calibration, checkpoints. Bytes in and out, no processing."""
