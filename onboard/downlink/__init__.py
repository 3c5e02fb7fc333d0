"""Downlink of a frame: strips around detections, codecs, packets, thumbnail, whole frames, and the bit budget."""
