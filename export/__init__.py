"""A trained detector as one ONNX file that the runtime reads, checked against PyTorch."""
