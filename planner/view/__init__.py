"""The live view: a problem's report in the browser, solved anew whenever its files are saved."""
