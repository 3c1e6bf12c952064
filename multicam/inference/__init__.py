"""From pixels to object poses with uncertainty: the ONNX network, decoding, PnP."""
