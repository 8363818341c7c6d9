MODULE TwoArms
    ! Problem two_arms, strategy ladder
    ! numpy 2.4, planner 1.0
    ! 1 beads in 1 layers, 12.0 mm deposited, 1.8 s
    ! Verified before it was written:
    !   position_error: 0.0021 mm (limit 0.05)
    !   reach: 0 mm (limit 0)
    ! MultiMove: TwoArms.mod in task T_ROB1 and TwoArms_Rob2.mod in T_ROB2 run at the
    ! same time: load both, set both program pointers to main, start both. Neither runs without the other.
    ! 40 moves, 3 of them along beads, whose toolpath has 12 waypoints
    ! Note: 3 lines are sent at fly-by points, as early as the controller reads ahead
    !   first bead 0, line 95 of TwoArms.mod

    ! The load below is a placeholder: identify it on the robot before the first run.
    PERS tooldata tPen:=[TRUE,[[-44.510,9.900,113.950],[1.0000000,0.0000000,0.0000000,0.0000000]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    ! Poses in the world that the controller's configuration must have. The robot's base:
    !   [[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]]
    ! The base of ROB_2, ABB IRB 1200-5/0.9:
    !   [[1459.650,9.870,-210.320],[0.0000000,0.0000000,0.0000000,1.0000000]]
    ! The user frame is the flange of ROB_2; the part frame stands in it.
    PERS wobjdata wobjPart:=[FALSE,FALSE,"ROB_2",[[0.000,0.000,0.000],[1.0000000,0.0000000,0.0000000,0.0000000]],[[0.000,0.000,0.000],[0.0000000,0.0000000,0.0000000,1.0000000]]];
    PERS tasks bwTasks{2}:=[["T_ROB1"],["T_ROB2"]];
    VAR syncident bwPlaced;
    VAR syncident bwTogether;
    VAR syncident bwApart;

    CONST speeddata vel41:=[41,350,1000,100];
    CONST speeddata vel42_3:=[42.3,350,1000,100];
    CONST speeddata vel45:=[45,350,1000,100];
    CONST speeddata vel125:=[125,350,1000,100];
    CONST speeddata vel150:=[150,350,1000,100];
    CONST speeddata vel200:=[200,350,1000,100];

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
        TPWrite "TwoArms: 1 beads";
        SingArea\Off;
        ConfJ\On;
        ConfL\Off;
        CirPathMode\ObjectFrame;
        SetDO doExtrude,0;
        TriggIO trgOn,0\DOp:=doExtrude,1;
        TriggIO trgOff,0\DOp:=doExtrude,0;
        TriggIO trgOnStart,0\Start\DOp:=doExtrude,1;
        WaitSyncTask bwPlaced,bwTasks;
        MoveAbsJ [[30.00000,20.00000,30.00000,90.00000,-80.00000,60.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],vel200,fine,tPen;
        SyncMoveOn bwTogether,bwTasks;
        BwOpen;
        Start;
        Bead0001;
        Finish;
        BwEnd;
        SyncMoveOff bwApart;
        SetDO doExtrude,0;
        TPWrite "Finished";
    UNDO
        SyncMoveUndo;
    ENDPROC

    PROC Start()
        ! The planned start as a target: the robot must not move here, if tool and work object are right.
        MoveJ [[-185.815,38.927,-2.946],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=1,vel200,fine,tPen\WObj:=wobjPart;
        BwLine 1,"M83";
        BwLine 2,"T0";
    ENDPROC

    PROC Bead0001()
        ! Bead 0, layer 0: 11.8 mm
        MoveJ [[-175.242,38.900,0.396],[0.6031430,0.7267661,0.1759886,0.2775925],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=2,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-163.707,38.838,6.725],[0.6015149,0.7190417,0.1815943,0.2969552],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=3,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-148.355,38.691,18.940],[0.5988811,0.7071422,0.1877722,0.3256269],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=4,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-122.331,38.403,46.097],[0.5950646,0.6809427,0.1999372,0.3771475],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=5,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-111.806,38.441,57.211],[0.5942056,0.6682900,0.2076247,0.3964847],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=6,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-103.249,38.633,65.141],[0.5938093,0.6575884,0.2157894,0.4103692],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=7,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-94.541,39.012,71.544],[0.5935700,0.6467512,0.2260559,0.4222396],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=8,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-85.661,39.592,75.913],[0.5933206,0.6361524,0.2385379,0.4317181],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=9,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-76.630,40.353,77.925],[0.5928541,0.6261317,0.2531440,0.4386356],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=10,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-67.534,41.242,77.492],[0.5919662,0.6169476,0.2695698,0.4430393],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=11,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-58.529,42.182,74.780],[0.5905014,0.6087489,0.2873244,0.4451715],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=12,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-47.713,43.313,68.802],[0.5877651,0.5999281,0.3104342,0.4452517],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=13,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-19.045,45.651,42.323],[0.5739390,0.5791033,0.3807288,0.4362099],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=14,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-11.732,45.927,34.993],[0.5688532,0.5730781,0.4006905,0.4329372],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=15,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-6.208,45.986,30.587],[0.5648549,0.5675967,0.4161459,0.4308080],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=16,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-2.230,45.922,28.783],[0.5621260,0.5627419,0.4273543,0.4297722],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=17,vel150,z1,tPen\WObj:=wobjPart;
        MoveJ [[-1.416,45.895,28.637],[0.5616107,0.5616110,0.4296427,0.4296437],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=18,vel41,fine,tPen\WObj:=wobjPart;
        TriggL [[-2.083,42.905,30.033],[0.5416803,0.5416803,0.4545134,0.4545134],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=19,vel45,trgOn,z5,tPen\WObj:=wobjPart;
        BwLine 3,"G1 E0.50702 F304.212";
        MoveC [[-2.368,40.968,30.969],[0.5280799,0.5280799,0.4702463,0.4702463],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.545,38.934,31.700],[0.5140227,0.5140227,0.4855725,0.4855725],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=20,vel42_3,z5,tPen\WObj:=wobjPart;
        BwLine 4,"G1 E0.49891 F299.346";
        MoveC [[-2.600,36.941,31.996],[0.4995210,0.4995210,0.5004786,0.5004786],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.537,34.936,31.805],[0.4845871,0.4845871,0.5149518,0.5149518],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=21,vel42_3,z5,tPen\WObj:=wobjPart;
        BwLine 5,"G1 E0.49078 F306.738";
        TriggC [[-2.361,32.979,31.185],[0.4698560,0.4698560,0.5284272,0.5284272],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-2.088,31.125,30.329],[0.4547504,0.4547504,0.5414813,0.5414813],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=22,vel42_3,trgOff,z5,tPen\WObj:=wobjPart;
        MoveL [[-1.416,28.105,28.857],[0.4296436,0.4296436,0.5616105,0.5616105],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=23,vel45,fine,tPen\WObj:=wobjPart;
    ENDPROC

    PROC Finish()
        MoveJ [[-3.754,28.397,31.849],[0.4371840,0.4388876,0.5468004,0.5632558],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=24,vel125,z5,tPen\WObj:=wobjPart;
        MoveJ [[-6.968,28.428,37.227],[0.4466972,0.4489561,0.5283424,0.5654683],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=25,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-11.683,28.041,45.792],[0.4590633,0.4607544,0.5040356,0.5682555],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=26,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-20.001,26.741,60.006],[0.4772771,0.4774993,0.4665387,0.5714390],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=27,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-37.294,23.237,81.687],[0.5057164,0.5071069,0.4016387,0.5707713],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=28,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-47.102,21.281,88.948],[0.5183147,0.5236588,0.3698984,0.5659563],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=29,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-55.521,19.806,92.282],[0.5277882,0.5384073,0.3449379,0.5590841],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=30,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-64.247,18.587,92.915],[0.5366173,0.5544025,0.3211910,0.5491048],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=31,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-73.136,17.772,90.667],[0.5448044,0.5714130,0.2992940,0.5358157],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=32,vel200,z1,tPen\WObj:=wobjPart;
        MoveJ [[-82.108,17.464,85.648],[0.5524131,0.5890744,0.2796881,0.5192356],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=33,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-91.145,17.706,78.244],[0.5595269,0.6069226,0.2625821,0.4996251],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=34,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-102.559,18.752,66.554],[0.5678172,0.6287237,0.2446623,0.4716253],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=35,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-116.432,20.910,50.829],[0.5769027,0.6529414,0.2275981,0.4347987],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=36,vel200,z10,tPen\WObj:=wobjPart;
        MoveJ [[-149.922,28.474,16.961],[0.5941963,0.6986689,0.1983958,0.3455888],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=37,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-166.224,32.932,5.473],[0.5999583,0.7156251,0.1858967,0.3055704],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=38,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-179.414,36.888,-0.872],[0.6030824,0.7277653,0.1751450,0.2756330],[0,0,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=39,vel200,z5,tPen\WObj:=wobjPart;
        MoveJ [[-185.815,38.927,-2.946],[0.6040228,0.7333283,0.1695307,0.2620026],[0,1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]\ID:=40,vel200,fine,tPen\WObj:=wobjPart;
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
        SocketSend bwClient\Str:="H TwoArms 5\0A";
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
        SystemStopAction\StopBlock;
    ERROR
        ! nobody may be there to be told
        TRYNEXT;
    ENDPROC
ENDMODULE
