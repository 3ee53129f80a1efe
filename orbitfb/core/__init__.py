"""The words and the ports of the house: values, protocols, errors. Numpy only."""
