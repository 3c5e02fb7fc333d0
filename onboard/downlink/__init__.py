"""What is sent of a frame: strips around detections, codecs, packets, thumbnail, whole frames, and what fits into the budget."""
