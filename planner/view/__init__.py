"""The live view: a problem's report in the browser, solved again whenever its files are saved."""
