"""Parameters from measurements: sensor identification, the validation loads of paper 000."""
