"""On board: frame -> calibration -> background -> stars -> detections -> ROI strips -> packets.

`chain` knows the order. The packages are its steps: `image`, `stars`, `detect`, `track`, `downlink`. They import the contract
(`sboc_e2e.icd`) and nothing else of the project.
"""
