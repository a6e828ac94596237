"""Controls: methods that pass a scene with closed eyes, by waiting or by driving slowly.

`names` has their names and the best of them; `policies` has who drives.
"""
