"""On board: frame -> calibration -> background -> stars -> detections -> ROI strips -> packets.

`chain` knows the order. The rooms are its steps: `image`, `stars`, `detect`, `downlink`. They import the contract
(`sboc_e2e.icd`) and nothing else of the project.
"""
