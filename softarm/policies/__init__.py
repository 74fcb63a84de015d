"""Policies: the plug-in interface, the built-in policies and the loading of ONNX files."""
