"""From a skinned surface to α and β: welding, weight gradients, influence slots."""
