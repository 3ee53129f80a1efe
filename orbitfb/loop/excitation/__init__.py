"""Small known movements of the setpoints: the dither and planned excitations."""
