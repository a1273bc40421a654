"""Speed against error of kc2spice, its peers and a lower bound; not part of the package."""
