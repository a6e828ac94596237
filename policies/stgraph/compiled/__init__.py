"""The paper's network compiled for the CPU, forward and backward."""
