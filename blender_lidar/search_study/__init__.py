"""How the searches do beside each other and beside other people's: development problems, BBOB and our own scene."""
