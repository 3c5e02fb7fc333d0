"""On board: frame -> calibration -> background -> stars -> detections -> ROI strips -> packets.

`chain` knows the order; every other module does one step. Imports the contract (`sboc_e2e.icd`) and nothing else of
the project.
"""
