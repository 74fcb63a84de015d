"""The simulator on a graphics card: the kernel of the CPU, compiled for CUDA, with the robots in torch tensors."""
