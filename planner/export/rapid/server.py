"""Style `socket`: the part of the program that hands lines to a relay, and stops the robot when nobody takes them.

The controller is the server of one connection. Lines of ASCII, ended by LF, at most 80 characters:
`H module lines`, answered by `G 1`; `L n gcode`, n = 1, 2, 3 …; `E n` at the end; `X n reason` where it stops by itself.
The relay says `A n`: every line up to n was taken; and `S reason`: stop. See docs/rapid.md.
"""

from __future__ import annotations

from collections.abc import Iterable

WINDOW = 16  # lines that may be on their way
PATIENCE = 2  # s without an answer, after which the robot stops
JOINING = 600  # s that the program waits for the relay to connect
LATEST = 900  # s that it waits for lines that the board acknowledges when they are over, such as heating
FIRST_PORT, LAST_PORT = 1025, 4999  # that a problem may ask for
PIECE = 38  # bytes read at once, and longest line of the relay's: both together fit into a string of 80
# procedures of the server that the program calls
OPEN, LINE, SETTLE, END = "BwOpen", "BwLine", "BwSettle", "BwEnd"

_DECLARATIONS = r"""
    VAR socketdev bwServer;
    VAR socketdev bwClient;
    VAR string bwHeard:="";
    VAR num bwSent:=0;
    VAR num bwTaken:=0;
    VAR bool bwGo:=FALSE;
"""
_PROCEDURES = r"""
    PROC BwOpen()
        ! Waits for the relay that takes the extruder's lines.
        bwHeard:="";
        bwSent:=0;
        bwTaken:=0;
        bwGo:=FALSE;
        SocketClose bwClient;
        SocketClose bwServer;
        SocketCreate bwServer;
        SocketBind bwServer,"{address}",{port};
        SocketListen bwServer;
        TPWrite "Waiting for the relay at port {port}";
        SocketAccept bwServer,bwClient\Time:={joining};
        SocketSend bwClient\Str:="H {module} {lines}\0A";
        WHILE NOT bwGo DO
            BwHear {patience};
        ENDWHILE
    ERROR
        BwStop "no connection to a relay";
    ENDPROC

    PROC BwLine(num n,string gcode)
        ! Sends line n; waits while too many are on their way.
        IF n<>bwSent+1 THEN
            BwStop "lines out of order in the program";
        ENDIF
        BwHear 0;
        WHILE bwSent-bwTaken>={window} DO
            BwHear {patience};
        ENDWHILE
        SocketSend bwClient\Str:="L "+NumToStr(n,0)+" "+gcode+"\0A";
        bwSent:=n;
    ERROR
        BwStop "connection lost";
    ENDPROC

    PROC BwSettle(num patience)
        ! Waits until every line is taken.
        WHILE bwTaken<bwSent DO
            BwHear patience;
        ENDWHILE
    ENDPROC

    PROC BwHear(num patience)
        ! Takes what the relay has said; where that is nothing, waits for it, unless patience is 0 s.
        VAR num here;
        VAR num at;
        VAR string part;
        here:=SocketPeek(bwClient);
        IF here=0 AND patience=0 THEN
            RETURN;
        ENDIF
        IF patience=0 THEN
            patience:={patience};
        ENDIF
        IF here=0 THEN
            here:=1;
        ELSEIF here>{piece} THEN
            here:={piece};
        ENDIF
        SocketReceive bwClient\Str:=part\ReadNoOfBytes:=here\Time:=patience;
        ! behind all that was heard there is always one more character: no place in an empty string may be asked for
        bwHeard:=bwHeard+part+" ";
        at:=StrFind(bwHeard,1,"\0A");
        WHILE at<StrLen(bwHeard) DO
            IF at<4 THEN
                BwStop "unknown words of the relay";
            ENDIF
            BwTake StrPart(bwHeard,1,at-1);
            bwHeard:=StrPart(bwHeard,at+1,StrLen(bwHeard)-at);
            at:=StrFind(bwHeard,1,"\0A");
        ENDWHILE
        IF StrLen(bwHeard)=1 THEN
            bwHeard:="";
        ELSE
            bwHeard:=StrPart(bwHeard,1,StrLen(bwHeard)-1);
        ENDIF
        IF StrLen(bwHeard)>{piece} THEN
            BwStop "unknown words of the relay";
        ENDIF
    ERROR
        IF ERRNO=ERR_SOCK_TIMEOUT THEN
            BwStop "no answer of the relay";
        ENDIF
        BwStop "connection lost";
    ENDPROC

    PROC BwTake(string said)
        ! One line of the relay: its first letter, a blank, and a number or a reason.
        VAR num n:=-1;
        VAR bool whole;
        IF StrPart(said,1,2)="S " THEN
            BwStop "the relay asked for it";
        ENDIF
        whole:=StrToVal(StrPart(said,3,StrLen(said)-2),n);
        IF whole AND StrPart(said,1,2)="G " AND n=1 AND NOT bwGo THEN
            bwGo:=TRUE;
        ELSEIF whole AND StrPart(said,1,2)="A " AND n>=bwTaken AND n<=bwSent AND n=Trunc(n) THEN
            bwTaken:=n;
        ELSE
            BwStop "unknown words of the relay";
        ENDIF
    ENDPROC

    PROC BwEnd()
        ! Everything was sent: says so when all of it is taken.
        BwSettle {latest};
        SocketSend bwClient\Str:="E "+NumToStr(bwSent,0)+"\0A";
        SocketClose bwClient;
        SocketClose bwServer;
    ERROR
        BwStop "connection lost";
    ENDPROC

    PROC BwStop(string reason)
        ! Robot and extruder come to rest, both sides read why, and the program ends; it may start from main again.
        StopMove;
{outputs}
        TPWrite "Stopped after line "+NumToStr(bwSent,0)+":";
        TPWrite reason;
        IF SocketGetStatus(bwClient)=SOCKET_CONNECTED THEN
            SocketSend bwClient\Str:="X "+NumToStr(bwSent,0)+" "+reason+"\0A";
        ENDIF
        SocketClose bwClient;
        SocketClose bwServer;
        WaitRob\ZeroSpeed;
        ! the robot may have passed a trigger before it stood
{outputs}
        ClearPath;
        StartMove;
        EXIT;
    ERROR
        ! nobody may be there to be told
        TRYNEXT;
    ENDPROC
"""


def server_declarations() -> list[str]:
    """Variables of the server, which stand before the first procedure."""
    return _DECLARATIONS.strip("\n").split("\n")


def server(module: str, lines: int, address: str, port: int, outputs: Iterable[str]) -> list[str]:
    """Procedures of the server of a program that sends so many lines; `outputs` are switched off where it stops."""
    said = {
        "module": module,
        "lines": lines,
        "address": address,
        "port": port,
        "outputs": "\n".join(f"        SetDO {name},0;" for name in outputs),
        "window": WINDOW,
        "patience": PATIENCE,
        "joining": JOINING,
        "latest": LATEST,
        "piece": PIECE,
    }
    return _PROCEDURES.format(**said).strip("\n").split("\n")
