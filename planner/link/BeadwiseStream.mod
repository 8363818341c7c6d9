MODULE BeadwiseStream
    ! Takes moves from a PC while the robot runs them: the PC's side is python -m planner.link.stream.
    ! Frames of 116 bytes come in, numbered and with a checksum, up to eight with one reading, which takes some 6 ms
    ! however much is read; lines of ASCII go back, ended by LF:
    !   B version capacity plan   after the connection: how many frames fit here, and what of a plan this module has
    !   C taken done              frames that have come, and frames handed to the motion: no frame beyond done + capacity
    !   E n starved               finished after n frames; starved times the robot waited for frames within a bead
    !   X n reason                stopped by itself
    ! The robot sets off from rest only once all moves up to the next rest are here, or the buffer is full.

    RECORD bsstep
        num number;
        byte kind;
        byte flags;
        byte tool;
        pos at;
        orient turn;
        confdata conf;
        extjoint axes;
        speeddata speed;
        num wait;
        num zone;
        num left;
        pos via;
        num flowStart;
        num flowEnd;
    ENDRECORD

    ! --- of the plan ---
    CONST string bsAddress:="127.0.0.1";
    CONST num bsPort:=1026;
    CONST string bsPlan:="00000000";
    PERS tooldata tBeadwise:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,50],[1,0,0,0],0,0,0]];
    PERS wobjdata wobjBeadwise:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
    ! --- of every plan ---
    CONST num bsVersion:=3;
    CONST num bsCapacity:=256;
    CONST num bsFrame:=116;
    CONST num bsAtOnce:=8;
    CONST num bsSilence:=2;
    CONST num bsJoining:=600;
    CONST num bsStarving:=0.5;

    ! of as many moves as the motion may run ahead by: what a move waits for must not be changed
    VAR triggdata bsStarting{16};
    VAR triggdata bsEnding{16};
    VAR triggdata bsFlowing{16};
    VAR triggdata bsFlowOn{16};
    VAR num bsState{8};
    VAR socketdev bsServer;
    VAR socketdev bsClient;
    VAR rawbytes bsRaw;
    VAR clock bsQuiet;
    VAR clock bsHungry;
    VAR bsstep bsRing{256};
    VAR num bsTaken:=0;
    VAR num bsDone:=0;
    VAR num bsStarved:=0;
    VAR num bsTold:=0;
    VAR bool bsResting:=TRUE;
    VAR bool bsHalted:=FALSE;

    ! --- of the plan ---
    PROC BsTrigg(bsstep next,robtarget via,robtarget target,zonedata zone)
        VAR num s;
        s:=1+bsDone MOD 16;
        TEST next.tool
        CASE 0:
            IF BitCheck(next.flags,1) bsState{1}:=1;
            TriggIO bsStarting{s},0\Start\DOp:=doExtrude,bsState{1};
            IF BitCheck(next.flags,2) bsState{1}:=1;
            IF BitCheck(next.flags,3) bsState{1}:=0;
            TriggIO bsEnding{s},0\DOp:=doExtrude,bsState{1};
        DEFAULT:
            BsStop "unknown tool";
        ENDTEST
        IF next.kind=7 THEN
            TriggC via,target,next.speed,bsStarting{s}\T2:=bsEnding{s},zone,tBeadwise\WObj:=wobjBeadwise;
        ELSE
            TriggL target,next.speed,bsStarting{s}\T2:=bsEnding{s},zone,tBeadwise\WObj:=wobjBeadwise;
        ENDIF
    ENDPROC

    PROC BsAllOff()
        SetDO doExtrude,0;
    ENDPROC

    PROC BsUnits(bool active)
        ! No station: the part stands still.
    ENDPROC

    ! --- of every plan ---
    PROC main()
        SingArea\Off;
        ConfJ\On;
        ConfL\Off;
        BsAllOff;
        BsUnits TRUE;
        BsOpen;
        WHILE NOT bsHalted DO
            BsHear;
            IF BsReady() THEN
                BsMove;
            ELSE
                WaitTime 0.004;
            ENDIF
        ENDWHILE
        BsAllOff;
        BsUnits FALSE;
    ENDPROC

    PROC BsOpen()
        bsTaken:=0;
        bsDone:=0;
        bsStarved:=0;
        bsTold:=0;
        FOR i FROM 1 TO 8 DO
            bsState{i}:=0;
        ENDFOR
        bsResting:=TRUE;
        bsHalted:=FALSE;
        SocketClose bsClient;
        SocketClose bsServer;
        SocketCreate bsServer;
        SocketBind bsServer,bsAddress,bsPort;
        SocketListen bsServer;
        TPWrite "Waiting for the PC at port "+NumToStr(bsPort,0);
        SocketAccept bsServer,bsClient\Time:=bsJoining;
        SocketSend bsClient\Str:="B "+NumToStr(bsVersion,0)+" "+NumToStr(bsCapacity,0)+" "+bsPlan+"\0A";
        ClkReset bsQuiet;
        ClkStart bsQuiet;
    ERROR
        BsStop "no connection to a PC";
    ENDPROC

    PROC BsHear()
        ! Takes what is here with one reading, and no more, for the motion waits for moves meanwhile; the PC sends a frame
        ! at least twice a second, if only to say that it is there.
        VAR num many;
        many:=SocketPeek(bsClient) DIV bsFrame;
        IF many>bsAtOnce THEN
            many:=bsAtOnce;
        ENDIF
        IF many>0 THEN
            SocketReceive bsClient\RawData:=bsRaw\ReadNoOfBytes:=many*bsFrame\Time:=bsSilence;
            FOR i FROM 0 TO many-1 DO
                BsTake i*bsFrame;
            ENDFOR
            ClkReset bsQuiet;
            ClkStart bsQuiet;
            BsCredit;
        ENDIF
        IF ClkRead(bsQuiet)>bsSilence THEN
            BsStop "silence of the PC";
        ENDIF
    ERROR
        BsStop "connection lost";
    ENDPROC

    PROC BsCredit()
        bsTold:=bsDone;
        SocketSend bsClient\Str:="C "+NumToStr(bsTaken,0)+" "+NumToStr(bsDone,0)+"\0A";
    ERROR
        BsStop "connection lost";
    ENDPROC

    PROC BsTake(num at)
        ! The frame behind so many bytes: checked and put into the ring.
        VAR bsstep new;
        VAR num sum;
        VAR num sums;
        VAR num word;
        VAR num said;
        VAR num saids;
        VAR num slot;
        FOR i FROM 0 TO 55 DO
            UnpackRawBytes bsRaw,at+1+2*i,word\IntX:=UINT;
            sum:=(sum+word) MOD 65535;
            sums:=(sums+sum) MOD 65535;
        ENDFOR
        UnpackRawBytes bsRaw,at+113,said\IntX:=UINT;
        UnpackRawBytes bsRaw,at+115,saids\IntX:=UINT;
        IF sum<>said OR sums<>saids THEN
            BsStop "wrong checksum";
        ENDIF
        UnpackRawBytes bsRaw,at+1,new.number\IntX:=UDINT;
        UnpackRawBytes bsRaw,at+5,new.kind\Hex1;
        UnpackRawBytes bsRaw,at+6,new.flags\Hex1;
        UnpackRawBytes bsRaw,at+7,new.tool\Hex1;
        IF new.kind=6 THEN
            RETURN;
        ENDIF
        IF new.kind=5 THEN
            BsStop "the PC asked for it";
        ENDIF
        IF new.number<>bsTaken+1 OR new.kind<1 OR new.kind=5 OR new.kind>7 OR new.tool>7 THEN
            BsStop "a frame out of order";
        ENDIF
        IF bsTaken-bsDone>=bsCapacity THEN
            BsStop "more frames than fit";
        ENDIF
        UnpackRawBytes bsRaw,at+9,new.at.x\Float4;
        UnpackRawBytes bsRaw,at+13,new.at.y\Float4;
        UnpackRawBytes bsRaw,at+17,new.at.z\Float4;
        UnpackRawBytes bsRaw,at+21,new.turn.q1\Float4;
        UnpackRawBytes bsRaw,at+25,new.turn.q2\Float4;
        UnpackRawBytes bsRaw,at+29,new.turn.q3\Float4;
        UnpackRawBytes bsRaw,at+33,new.turn.q4\Float4;
        UnpackRawBytes bsRaw,at+37,new.conf.cf1\IntX:=SINT;
        UnpackRawBytes bsRaw,at+38,new.conf.cf4\IntX:=SINT;
        UnpackRawBytes bsRaw,at+39,new.conf.cf6\IntX:=SINT;
        UnpackRawBytes bsRaw,at+40,new.conf.cfx\IntX:=SINT;
        UnpackRawBytes bsRaw,at+41,new.axes.eax_a\Float4;
        UnpackRawBytes bsRaw,at+45,new.axes.eax_b\Float4;
        UnpackRawBytes bsRaw,at+49,new.axes.eax_c\Float4;
        UnpackRawBytes bsRaw,at+53,new.axes.eax_d\Float4;
        UnpackRawBytes bsRaw,at+57,new.axes.eax_e\Float4;
        UnpackRawBytes bsRaw,at+61,new.axes.eax_f\Float4;
        UnpackRawBytes bsRaw,at+65,new.speed.v_tcp\Float4;
        UnpackRawBytes bsRaw,at+69,new.speed.v_ori\Float4;
        UnpackRawBytes bsRaw,at+73,new.speed.v_leax\Float4;
        UnpackRawBytes bsRaw,at+77,new.speed.v_reax\Float4;
        UnpackRawBytes bsRaw,at+81,new.wait\Float4;
        UnpackRawBytes bsRaw,at+85,new.zone\Float4;
        UnpackRawBytes bsRaw,at+89,new.left\IntX:=UINT;
        UnpackRawBytes bsRaw,at+93,new.via.x\Float4;
        UnpackRawBytes bsRaw,at+97,new.via.y\Float4;
        UnpackRawBytes bsRaw,at+101,new.via.z\Float4;
        UnpackRawBytes bsRaw,at+105,new.flowStart\Float4;
        UnpackRawBytes bsRaw,at+109,new.flowEnd\Float4;
        bsTaken:=new.number;
        slot:=1+(bsTaken-1) MOD bsCapacity;
        bsRing{slot}:=new;
    ENDPROC

    FUNC bool BsReady()
        ! Whether the next move may be handed to the motion.
        VAR num here;
        VAR num slot;
        here:=bsTaken-bsDone;
        IF here=0 THEN
            IF NOT bsResting THEN
                IF ClkRead(bsHungry)=0 THEN
                    bsStarved:=bsStarved+1;
                    ClkStart bsHungry;
                ELSEIF ClkRead(bsHungry)>bsStarving THEN
                    BsStop "no frames within a bead";
                ENDIF
            ENDIF
            RETURN FALSE;
        ENDIF
        ClkStop bsHungry;
        ClkReset bsHungry;
        IF NOT bsResting THEN
            RETURN TRUE;
        ENDIF
        slot:=1+bsDone MOD bsCapacity;
        RETURN here>=bsRing{slot}.left OR here=bsCapacity;
    ENDFUNC

    PROC BsMove()
        ! Hands the next frame to the motion, which runs ahead of the robot by a few moves.
        VAR bsstep next;
        VAR robtarget target;
        VAR zonedata zone;
        VAR robtarget via;
        VAR num slot;
        slot:=1+bsDone MOD bsCapacity;
        next:=bsRing{slot};
        IF next.kind=4 THEN
            WaitRob\InPos;
            SocketSend bsClient\Str:="E "+NumToStr(bsDone,0)+" "+NumToStr(bsStarved,0)+"\0A";
            SocketClose bsClient;
            SocketClose bsServer;
            bsHalted:=TRUE;
            RETURN;
        ENDIF
        zone:=[next.zone=0,next.zone,next.zone,next.zone,next.zone/10,next.zone,next.zone/10];
        target:=[next.at,next.turn,next.conf,next.axes];
        via:=[next.via,next.turn,next.conf,next.axes];
        IF BitAnd(next.flags,31)<>0 THEN
            BsTrigg next,via,target,zone;
        ELSEIF next.kind=3 THEN
            MoveAbsJ BsJoints(next),next.speed,zone,tBeadwise\WObj:=wobjBeadwise;
        ELSEIF next.kind=2 THEN
            MoveJ target,next.speed,zone,tBeadwise\WObj:=wobjBeadwise;
        ELSEIF next.kind=7 THEN
            MoveC via,target,next.speed,zone,tBeadwise\WObj:=wobjBeadwise;
        ELSE
            MoveL target,next.speed,zone,tBeadwise\WObj:=wobjBeadwise;
        ENDIF
        bsResting:=next.zone=0;
        BsWait next.wait;
        bsDone:=bsDone+1;
        IF bsResting OR BitCheck(next.flags,6) OR bsDone-bsTold>=bsAtOnce THEN
            BsCredit;
        ENDIF
    ERROR
        IF ERRNO=ERR_SOCK_CLOSED THEN
            BsStop "connection lost";
        ENDIF
        BsStop "error "+NumToStr(ERRNO,0)+" of a move";
    ENDPROC

    FUNC jointtarget BsJoints(bsstep next)
        ! Joints stand where place and orientation stand in other frames.
        VAR jointtarget joints;
        joints.robax.rax_1:=next.at.x;
        joints.robax.rax_2:=next.at.y;
        joints.robax.rax_3:=next.at.z;
        joints.robax.rax_4:=next.turn.q1;
        joints.robax.rax_5:=next.turn.q2;
        joints.robax.rax_6:=next.turn.q3;
        joints.extax:=next.axes;
        RETURN joints;
    ENDFUNC

    PROC BsWait(num seconds)
        ! Stands still and goes on listening.
        VAR clock passed;
        IF seconds=0 THEN
            RETURN;
        ENDIF
        ClkReset passed;
        ClkStart passed;
        WHILE ClkRead(passed)<seconds AND (NOT bsHalted) DO
            BsHear;
            WaitTime 0.02;
        ENDWHILE
    ENDPROC

    PROC BsStop(string reason)
        ! Robot and extruder come to rest, both sides read why, and the program ends; it may start from main again.
        StopMove;
        BsAllOff;
        TPWrite "Stopped after frame "+NumToStr(bsDone,0)+":";
        TPWrite reason;
        IF SocketGetStatus(bsClient)=SOCKET_CONNECTED THEN
            SocketSend bsClient\Str:="X "+NumToStr(bsDone,0)+" "+reason+"\0A";
        ENDIF
        SocketClose bsClient;
        SocketClose bsServer;
        WaitRob\ZeroSpeed;
        ! the robot may have passed a trigger before it stood
        BsAllOff;
        ClearPath;
        StartMove;
        EXIT;
    ERROR
        ! nobody may be there to be told
        TRYNEXT;
    ENDPROC
ENDMODULE
