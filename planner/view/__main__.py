"""The live view: a report in the browser, solved again whenever its files are saved."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("view"))
