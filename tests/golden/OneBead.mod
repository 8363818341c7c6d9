MODULE OneBead
    ! Problem one_bead, strategy ladder
    ! numpy 2.4, planner 1.0
    ! 1 beads in 1 layers, 12.0 mm deposited, 1.8 s
    ! Verified before it was written:
    !   position_error: 0.0021 mm (limit 0.05)
    !   reach: 0 mm (limit 0)
    ! 8 moves, 3 of them along beads, whose toolpath has 12 waypoints
    ! Note: 2 lines are sent at fly-by points, as early as the controller reads ahead
    !   first bead 0, line 71 of OneBead.mod
    ! Note: 1 move on a bead is slowed by accelerations of the joints, the worst to 76 % of its speed
    !   first bead 0, line 75 of OneBead.mod

    ! The load below is a placeholder: identify it on the robot before the first run.
    PERS tooldata tPen:=[TRUE,[[-44.510,9.900,113.950],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    ! Poses in the world that the controller's configuration must have. The robot's base:
    !   [[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]
    PERS wobjdata wobjPart:=[FALSE,TRUE,"",[[450.000,-50.000,380.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]];

    CONST speeddata vel42_3:=[42.3,180,1000,100];
    CONST speeddata vel45:=[45,180,1000,100];
    CONST speeddata vel200:=[200,180,1000,100];

    VAR triggdata trgOn;
    VAR triggdata trgOff;
    VAR triggdata trgOnStart;
    VAR socketdev bwServer;
    VAR socketdev bwClient;
    VAR string bwHeard:="";
    VAR num bwSent:=0;
    VAR num bwTaken:=0;
    VAR bool bwGo:=FALSE;

    PROC main()
        TPWrite "OneBead: 1 beads";
        SingArea\Off;
        ConfJ\On;
        ConfL\Off;
        CirPathMode\ObjectFrame;
        SetDO doExtrude,0;
        TriggIO trgOn,0\DOp:=doExtrude,1;
        TriggIO trgOff,0\DOp:=doExtrude,0;
        TriggIO trgOnStart,0\Start\DOp:=doExtrude,1;
        MoveAbsJ [[30.00000,20.00000,30.00000,90.00000,-80.00000,60.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
        BwOpen;
        Start;
        Bead0001;
        Finish;
        BwEnd;
        SetDO doExtrude,0;
        TPWrite "Finished";
    ENDPROC

    PROC Start()
        ! The planned start as a target: the robot must not move here, if tool and work object are right.
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
        ! heat
        BwLine 1,"M83";
        BwLine 2,"T0";
        BwLine 3,"M140 S60";
        BwLine 4,"M104 S200";
        BwLine 5,"M190 S60";
        BwLine 6,"M109 S200";
        WaitTime 4.000;
        BwSettle 900;
    ENDPROC

    PROC Bead0001()
        ! Bead 0, layer 0: 11.8 mm
        MoveJ [[-1.416,45.895,28.637],[0.5616108,0.5616110,0.4296428,0.4296434],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
        TriggL [[-2.083,42.905,30.033],[0.5416803,0.5416803,0.4545134,0.4545134],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,trgOn,z5,tPen\WObj:=wobjPart;
        BwLine 7,"G1 E0.50702 F304.212";
        MoveC [[-2.368,40.968,30.969],[0.5280799,0.5280799,0.4702463,0.4702463],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.545,38.934,31.700],[0.5140227,0.5140227,0.4855725,0.4855725],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42_3,z5,tPen\WObj:=wobjPart;
        BwLine 8,"G1 E0.49891 F299.346";
        TriggC [[-2.600,36.941,31.996],[0.4995210,0.4995210,0.5004786,0.5004786],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.537,34.936,31.805],[0.4845871,0.4845871,0.5149518,0.5149518],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42_3,trgOff,fine,tPen\WObj:=wobjPart;
        ! cut, bead 0
        WaitTime 1.000;
        BwLine 9,"M106 P0 S1";
        BwLine 10,"G4 P500";
        BwLine 11,"M106 P0 S0";
        BwLine 12,"G4 P500";
        WaitTime 1.000;
        BwSettle 900;
        WaitTime 1.000;
        MoveC [[-2.361,32.979,31.185],[0.4698560,0.4698560,0.5284272,0.5284272],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.088,31.125,30.329],[0.4547504,0.4547504,0.5414813,0.5414813],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel42_3,z5,tPen\WObj:=wobjPart;
        MoveL [[-1.416,28.105,28.857],[0.4296436,0.4296436,0.5616105,0.5616105],[-1,-1,1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel45,fine,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Finish()
        MoveJ [[-2.311,98.797,-2.950],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen\WObj:=wobjPart;
    ENDPROC

    PROC BwOpen()
        ! Waits for the relay that takes the extruder's lines.
        bwHeard:="";
        bwSent:=0;
        bwTaken:=0;
        bwGo:=FALSE;
        SocketClose bwClient;
        SocketClose bwServer;
        SocketCreate bwServer;
        SocketBind bwServer,"127.0.0.1",1025;
        SocketListen bwServer;
        TPWrite "Waiting for the relay at port 1025";
        SocketAccept bwServer,bwClient\Time:=600;
        SocketSend bwClient\Str:="H OneBead 12\0A";
        WHILE NOT bwGo DO
            BwHear 2;
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
        WHILE bwSent-bwTaken>=16 DO
            BwHear 2;
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
            patience:=2;
        ENDIF
        IF here=0 THEN
            here:=1;
        ELSEIF here>38 THEN
            here:=38;
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
        IF StrLen(bwHeard)>38 THEN
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
        IF whole AND StrPart(said,1,2)="G " AND n=1 AND (NOT bwGo) THEN
            bwGo:=TRUE;
        ELSEIF whole AND StrPart(said,1,2)="A " AND n>=bwTaken AND n<=bwSent AND n=Trunc(n) THEN
            bwTaken:=n;
        ELSE
            BwStop "unknown words of the relay";
        ENDIF
    ENDPROC

    PROC BwEnd()
        ! Everything was sent: says so when all of it is taken.
        BwSettle 900;
        SocketSend bwClient\Str:="E "+NumToStr(bwSent,0)+"\0A";
        SocketClose bwClient;
        SocketClose bwServer;
    ERROR
        BwStop "connection lost";
    ENDPROC

    PROC BwStop(string reason)
        ! Robot and extruder come to rest, both sides read why, and the program ends; it may start from main again.
        StopMove;
        SetDO doExtrude,0;
        TPWrite "Stopped after line "+NumToStr(bwSent,0)+":";
        TPWrite reason;
        IF SocketGetStatus(bwClient)=SOCKET_CONNECTED THEN
            SocketSend bwClient\Str:="X "+NumToStr(bwSent,0)+" "+reason+"\0A";
        ENDIF
        SocketClose bwClient;
        SocketClose bwServer;
        WaitRob\ZeroSpeed;
        ! the robot may have passed a trigger before it stood
        SetDO doExtrude,0;
        ClearPath;
        StartMove;
        EXIT;
    ERROR
        ! nobody may be there to be told
        TRYNEXT;
    ENDPROC
ENDMODULE
