"""How well missing physics is found in the diving plane of an AUV, over many simulated cases."""
