"""What is believed: the nominal model that goes in and the refined one that comes out."""
